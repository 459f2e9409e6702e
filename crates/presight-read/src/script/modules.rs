//! Modules of a script: files in the scene's folder. Each is read once; cyclic imports are errors.

use super::fault::{Fault, Sources};
use super::folder::{Folder, read_script};
use super::meter::is_exportable;
use super::tokens::Tokens;
use presight_model::error::Error;
use presight_model::limits;
use rhai::{Engine, EvalAltResult, Module, ModuleResolver, Position, Scope, Shared};
use std::cell::RefCell;
use std::collections::HashMap;
use std::path::PathBuf;
use std::rc::Rc;

/// Loads the modules that `import` names, relative to the scene's folder.
pub(super) struct Modules {
    folder: Folder,
    sources: Rc<RefCell<Sources>>,
    known: RefCell<HashMap<PathBuf, Option<Shared<Module>>>>,
    tokens: Tokens,
}

impl Modules {
    pub fn new(folder: Folder, main: PathBuf, sources: Rc<RefCell<Sources>>, tokens: Tokens) -> Self {
        // `None` marks a script that is being read, here the main one, which modules must not import.
        Self { folder, sources, known: RefCell::new(HashMap::from([(main, None)])), tokens }
    }

    fn load(&self, engine: &Engine, path: &str, at: Position) -> Result<Shared<Module>, Box<EvalAltResult>> {
        let fault = |e: Error| Fault::at(e, at);
        let file = if path.ends_with(".rhai") { path.to_owned() } else { format!("{path}.rhai") };
        let (shown, real) = self.folder.file(&file).map_err(fault)?;
        match self.known.borrow().get(&real) {
            Some(Some(module)) => return Ok(module.clone()),
            Some(None) => {
                let remedy = "put what both need into a third module";
                return Err(fault(Error::invalid(format!("module {path:?} imports itself"), remedy)));
            }
            None => {}
        }
        let fault = |e: Error| fault(e.in_file(&shown));
        let text = read_script(&shown, &real).map_err(fault)?;
        self.known.borrow_mut().insert(real.clone(), None);
        let name = shown.display().to_string();
        let mut ast = self.tokens.parse(engine, &text).map_err(fault)?;
        ast.set_source(&name);
        self.sources.borrow_mut().insert(name.clone(), text);
        let module = Module::eval_ast_as_new(Scope::new(), &ast, engine)
            .map_err(|e| Box::new(EvalAltResult::ErrorInModule(name, e, at)))?;
        if let Some((variable, _)) = module.iter_var().find(|(_, value)| !is_exportable(value)) {
            let what = format!("variable {variable:?} of the module has over {} elements", limits::MAX_SCRIPT_EXPORT);
            return Err(fault(Error::invalid(what, "return it from a function of the module")));
        }
        let module = Shared::new(module);
        self.known.borrow_mut().insert(real, Some(module.clone()));
        Ok(module)
    }
}

impl ModuleResolver for Modules {
    fn resolve(
        &self,
        engine: &Engine,
        _source: Option<&str>,
        path: &str,
        at: Position,
    ) -> Result<Shared<Module>, Box<EvalAltResult>> {
        self.load(engine, path, at)
    }
}
