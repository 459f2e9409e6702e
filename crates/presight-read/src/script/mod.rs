//! Scenes as scripts, `.rhai`: parametric shapes, placed as named objects, with materials, features and checks.
//!
//! The language is [Rhai](https://rhai.rs/book/).
//! [`scenes/README.md`](https://github.com/presight/presight/blob/main/scenes/README.md) lists the functions that build
//! scenes; [`reference()`] returns the same list. Lengths are in metres, parameters ending in `_deg` in degrees; z is
//! up.
//!
//! **The same script gives the same environment on every machine.** Trigonometry comes from `libm`, random numbers from
//! a seed in the script; there is no operator `**` and no clock. Scripts read files only from their own folder (with
//! symbolic links resolved), write no files, and cannot use `eval`. Limits on operations (large values count by size),
//! depth, sizes, polygons and memory ([`presight_model::limits`], `MAX_SCRIPT_..`) end a script with an error that
//! names file, line, column and call. A limit on time is only a last resort.
//!
//! `source` ids number triangles in the order of placing, as an exported scene would have them.

mod assembly;
mod budget;
mod call;
mod fault;
mod folder;
mod functions;
mod lost;
mod meter;
mod modules;
mod random;
mod shape;
mod studio;
mod tokens;

pub use functions::reference;

use crate::gltf::ImportOptions;
use crate::materials::sidecar_path;
use crate::preparation::ImportedScene;
use fault::{Fault, Sources, explain};
use folder::{Folder, read_script, script_of};
use modules::Modules;
use presight_model::error::{Error, Result};
use presight_model::{limits, threads};
use rhai::packages::{
    ArithmeticPackage, BasicArrayPackage, BasicFnPackage, BasicIteratorPackage, BasicMapPackage, BasicStringPackage,
    LogicPackage, MoreStringPackage, Package,
};
use rhai::{Engine, OptimizationLevel, Scope};
use std::cell::{Cell, RefCell};
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::sync::mpsc::{Receiver, Sender, TryRecvError, channel};
use std::time::Duration;
use studio::Studio;
use tokens::Tokens;

/// Stack of the thread that runs scripts, bytes. It is large enough for the limits on depth in every build.
const STACK: usize = 256 << 20;

/// Runs a script. `say` receives each line as soon as the script prints it.
///
/// `options` apply to the models that it imports. Without merging, polygons keep the order in which the script makes
/// them.
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`] with file, line, column, call and remedy for a script that is missing, not
/// UTF-8 or not Rhai, calls a function wrongly, exceeds a limit, or fails a `require`. As [`crate::gltf::import`] for
/// models that it imports.
pub fn load(path: impl AsRef<Path>, options: &ImportOptions, say: &mut dyn FnMut(&str)) -> Result<ImportedScene> {
    load_from(path.as_ref(), None, options, say)
}

/// As [`load`], for the text of a script in memory, which cannot import files. `name` stands in messages for the file.
///
/// On WebAssembly the script runs on the stack of the program: link it with 256 MiB for scripts nested as deeply as the
/// limits allow.
///
/// ```
/// let text = b"place(\"floor\", rectangle(6, 4));";
/// let scene = presight_read::script::load_bytes("floor.rhai", text, &Default::default(), &mut |_| {})?;
/// assert_eq!(scene.environment.objects().len(), 1);
/// # Ok::<(), presight::Error>(())
/// ```
///
/// # Errors
/// As [`load`]; [`presight_model::ErrorKind::Invalid`] if the script imports a file.
pub fn load_bytes(
    name: impl AsRef<Path>,
    bytes: &[u8],
    options: &ImportOptions,
    say: &mut dyn FnMut(&str),
) -> Result<ImportedScene> {
    load_from(name.as_ref(), Some(bytes), options, say)
}

/// Runs a script, from its file if there are no bytes.
fn load_from(
    path: &Path,
    bytes: Option<&[u8]>,
    options: &ImportOptions,
    say: &mut dyn FnMut(&str),
) -> Result<ImportedScene> {
    let (sender, receiver) = channel();
    threads::aside(
        "script",
        STACK,
        || run(path, bytes, options, sender).map_err(|e| e.in_file(path)),
        || listen_to(&receiver, say),
    )?
}

/// Passes on the lines that the script prints, until it ends and drops the sender.
fn listen_to(lines: &Receiver<String>, say: &mut dyn FnMut(&str)) {
    if rayon::current_thread_index().is_none() {
        return lines.iter().for_each(|line| say(&line));
    }
    // This thread is a rayon worker, which an import of the script may need, so it works while it waits.
    loop {
        match lines.try_recv() {
            Ok(line) => say(&line),
            Err(TryRecvError::Disconnected) => return,
            Err(TryRecvError::Empty) => {
                while rayon::yield_now() == Some(rayon::Yield::Executed) {}
                lines.recv_timeout(Duration::from_millis(1)).iter().for_each(|line| say(line));
            }
        }
    }
}

fn run(path: &Path, bytes: Option<&[u8]>, options: &ImportOptions, say: Sender<String>) -> Result<ImportedScene> {
    let (folder, real, text) = match bytes {
        Some(bytes) => (Folder::default(), path.to_owned(), script_of(bytes)?),
        None => {
            let folder = Folder::of(path)?;
            let real = path.canonicalize().map_err(|e| Error::io(path, "open it", e))?;
            refuse_sidecar(path)?;
            let text = read_script(path, &real)?;
            (folder, real, text)
        }
    };
    let name = path.display().to_string();
    let sources = Rc::new(RefCell::new(Sources::from([(name.clone(), text.clone())])));
    let studio = Rc::new(Studio::new(folder.clone(), options));
    let mut engine = engine(&studio, say);
    let tokens = Tokens::default();
    tokens.watch(&mut engine);
    engine.set_module_resolver(Modules::new(folder, real, sources.clone(), tokens.clone()));
    let mut ast = tokens.parse(&engine, &text)?;
    ast.set_source(&name);
    let ended = engine.run_ast_with_scope(&mut Scope::new(), &ast);
    ended.map_err(|e| explain(*e, &name, &sources.borrow()))?;
    let mut scene = studio.finish()?;
    scene.files.extend(sources.borrow().keys().map(PathBuf::from));
    Ok(scene)
}

/// Refuses a sidecar with materials, which a script would silently ignore. A sidecar of a model with the same name is
/// fine.
fn refuse_sidecar(path: &Path) -> Result<()> {
    let sidecar = sidecar_path(path);
    if !sidecar.exists() || ["glb", "gltf"].iter().any(|e| path.with_extension(e).exists()) {
        return Ok(());
    }
    let what = "scripts do not read materials from a file";
    Err(Error::invalid(what, "define them in the script with material(name, #{..})").in_file(sidecar))
}

/// Rhai with our functions and limits, without anything whose result may differ between machines.
fn engine(studio: &Rc<Studio>, say: Sender<String>) -> Engine {
    let mut engine = Engine::new_raw();
    ArithmeticPackage::new().register_into_engine(&mut engine);
    BasicStringPackage::new().register_into_engine(&mut engine);
    BasicIteratorPackage::new().register_into_engine(&mut engine);
    BasicFnPackage::new().register_into_engine(&mut engine);
    LogicPackage::new().register_into_engine(&mut engine);
    BasicArrayPackage::new().register_into_engine(&mut engine);
    BasicMapPackage::new().register_into_engine(&mut engine);
    MoreStringPackage::new().register_into_engine(&mut engine);
    engine.register_fn("to_string", Fault::message).register_fn("to_debug", Fault::message);
    // `**` of floats uses the C library, whose results differ between machines; so may results computed while
    // optimizing.
    engine.disable_symbol("**").disable_symbol("**=").disable_symbol("eval");
    engine.set_optimization_level(OptimizationLevel::None);
    functions::register(&mut engine, studio);
    meter::limit(&mut engine, studio.busy.clone());
    listen(&mut engine, say);
    engine
}

/// Passes on the lines that the script prints, up to the limit.
fn listen(engine: &mut Engine, say: Sender<String>) {
    let said = Cell::new(0u64);
    let send = Rc::new(move |line: String| {
        said.set(said.get() + 1);
        // Sending fails only if the receiver of the lines is gone.
        let _ = match said.get() {
            n if n <= limits::MAX_SCRIPT_MESSAGES => say.send(line),
            n if n == limits::MAX_SCRIPT_MESSAGES + 1 => say.send("(more lines are left out)".into()),
            _ => Ok(()),
        };
    });
    let print = send.clone();
    engine.on_print(move |line| print(line.to_owned()));
    engine.on_debug(move |line, source, at| send(format!("{}:{at}: {line}", source.unwrap_or_default())));
}
