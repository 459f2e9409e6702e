//! Worker threads: one handle shared by predictors, importers and everything else that works in parallel.
//!
//! Nothing runs on rayon's global pool, which starts lazily and panics if the system has no more threads. Starting our
//! own pool returns an error that a caller can handle.
//!
//! WebAssembly cannot start threads. There every handle means the calling thread, which does all work itself.

use crate::error::{Error, ErrorKind, Result};
use crate::limits;
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::cell::OnceCell;
use std::fmt;
use std::sync::{Arc, Mutex, OnceLock, PoisonError, Weak};

/// Worker threads, as a handle that is cheap to clone; clones share the same threads.
///
/// [`Threads::new`] starts separate threads. A number refers to threads shared by the whole process: all handles made
/// from the same number use the same threads, which start on first use and end with the last engine that holds them. A
/// process that was forked has threads of its own; started handles of its parent are of no use there. 0, the default,
/// means one thread per core (or `RAYON_NUM_THREADS`, if set); these threads are never stopped.
///
/// Functions without a handle, such as [`crate::World::new`] or `features::generate::generate`, use the
/// threads of [`Threads::run`] if called inside it, otherwise the default threads.
///
/// ```
/// use presight::environment::Environment;
/// use presight::{Backend, Options, Predictor, Threads, World};
/// let threads = Threads::new(2)?;
/// let world = threads.run(|| World::new(Environment::new()))?;
/// let predictor = Predictor::new(Options::new(Backend::Cpu).with_threads(threads.clone()))?;
/// let another = Predictor::new(Options::new(Backend::Cpu).with_threads(1))?;
/// # Ok::<(), presight::Error>(())
/// ```
#[derive(Clone, Default)]
pub struct Threads {
    /// Number of shared threads, 0 for the default.
    count: usize,
    pool: Option<Arc<ThreadPool>>,
}

impl Threads {
    /// The process's shared threads, one per core.
    pub const SHARED: Self = Self { count: 0, pool: None };

    /// Starts threads for this handle alone; 0 starts one per core.
    ///
    /// # Errors
    /// [`ErrorKind::Usage`] for more than max(64, twice the cores), also from `RAYON_NUM_THREADS`;
    /// [`ErrorKind::System`] if they cannot be started.
    pub fn new(count: usize) -> Result<Self> {
        let count = resolve(count)?;
        Ok(Self { count, pool: Some(start(count)?) })
    }

    /// A handle of these threads, started. It keeps shared threads alive.
    ///
    /// # Errors
    /// As [`Threads::new`].
    pub fn started(&self) -> Result<Self> {
        let pool = self.pool()?;
        Ok(Self { count: pool.current_num_threads(), pool: Some(pool) })
    }

    /// Number of threads; starts them if necessary.
    ///
    /// # Errors
    /// As [`Threads::new`].
    pub fn count(&self) -> Result<usize> {
        Ok(self.pool()?.current_num_threads())
    }

    /// Runs work on these threads. Parallel work inside it uses no other threads.
    ///
    /// # Errors
    /// As [`Threads::new`], if they do not run yet.
    pub fn run<R: Send>(&self, work: impl FnOnce() -> R + Send) -> Result<R> {
        Ok(self.pool()?.install(work))
    }

    /// The pool of these threads; starts them if necessary.
    pub fn pool(&self) -> Result<Arc<ThreadPool>> {
        match (&self.pool, self.count) {
            (Some(pool), _) => Ok(pool.clone()),
            (None, 0) => default_pool(),
            (None, count) => shared_pool(count),
        }
    }
}

impl From<usize> for Threads {
    /// `count` threads shared by the process; 0 means one per core.
    fn from(count: usize) -> Self {
        Self { count, pool: None }
    }
}

impl fmt::Debug for Threads {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (&self.pool, self.count) {
            (Some(pool), _) => write!(f, "Threads({} running)", pool.current_num_threads()),
            (None, 0) => f.write_str("Threads(one a core)"),
            (None, count) => write!(f, "Threads({count})"),
        }
    }
}

impl PartialEq for Threads {
    /// True for handles to the same threads. Shared threads are compared by number unless started.
    fn eq(&self, other: &Self) -> bool {
        self.count == other.count && self.pool.as_ref().map(Arc::as_ptr) == other.pool.as_ref().map(Arc::as_ptr)
    }
}

impl Eq for Threads {}

/// Runs work on the pool of the calling thread or, outside of any pool, on the process's shared threads.
///
/// # Errors
/// As [`Threads::new`], if these do not run yet.
pub fn parallel<R: Send>(work: impl FnOnce() -> R + Send) -> Result<R> {
    if rayon::current_thread_index().is_some() { Ok(work()) } else { Threads::SHARED.run(work) }
}

/// `parallel` for work that cannot fail: if no thread can be started, the calling thread does it all.
pub fn parallel_or_here<R: Send>(work: impl FnOnce() -> R + Send) -> R {
    if rayon::current_thread_index().is_some() {
        return work();
    }
    match default_pool().or_else(|_| calling_thread()) {
        Ok(pool) => pool.install(work),
        Err(_) => work(),
    }
}

/// Runs `main` on a new thread with `stack` bytes, and `meanwhile` on this thread in parallel. Without threads, `main`
/// runs first.
///
/// # Errors
/// [`ErrorKind::System`] if the thread cannot be started; then neither runs.
pub fn aside<R: Send>(
    name: &str,
    stack: usize,
    main: impl FnOnce() -> R + Send,
    meanwhile: impl FnOnce(),
) -> Result<R> {
    if cfg!(target_family = "wasm") {
        let done = main();
        meanwhile();
        return Ok(done);
    }
    std::thread::scope(|scope| {
        let thread = std::thread::Builder::new().name(name.to_owned()).stack_size(stack);
        let running = thread.spawn_scoped(scope, main).map_err(|e| {
            Error::new(ErrorKind::System, format!("cannot start a thread: {e}"), "free some memory").caused_by(e)
        })?;
        meanwhile();
        Ok(running.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)))
    })
}

/// [`rayon::in_place_scope`] on the pool of the calling thread or, outside of any, on the process's shared threads.
///
/// # Errors
/// As [`Threads::new`], if these do not run yet.
pub fn in_place_scope<'scope, R>(work: impl FnOnce(&rayon::Scope<'scope>) -> R) -> Result<R> {
    if rayon::current_thread_index().is_some() {
        return Ok(rayon::in_place_scope(work));
    }
    Ok(default_pool()?.in_place_scope(work))
}

/// A value that each process makes for itself.
///
/// After a fork the child has its parent's memory, but only the thread that forked: the others are gone, and a lock
/// that one of them held stays locked. So a child takes a value of its own and never touches the one of its parent.
#[derive(Debug)]
pub struct PerProcess<T> {
    /// The process that made the value, and the value.
    own: OnceLock<(u32, T)>,
    /// Those of child processes.
    next: OnceLock<Box<Self>>,
}

impl<T> PerProcess<T> {
    /// No process has made its value yet.
    pub const fn new() -> Self {
        Self { own: OnceLock::new(), next: OnceLock::new() }
    }
}

impl<T> Default for PerProcess<T> {
    fn default() -> Self {
        Self::new()
    }
}

impl<T: Default> PerProcess<T> {
    /// The value of this process. Its default must be quick to make: after a fork during its construction the child
    /// would never have it.
    pub fn get(&self) -> &T {
        self.of(this_process())
    }

    fn of(&self, process: u32) -> &T {
        let mut link = self;
        loop {
            let (owner, value) = link.own.get_or_init(|| (process, T::default()));
            if *owner == process {
                return value;
            }
            link = link.next.get_or_init(Box::default);
        }
    }
}

/// The number of this process; 0 on WebAssembly, which has none.
pub fn this_process() -> u32 {
    if cfg!(target_family = "wasm") { 0 } else { std::process::id() }
}

/// The default threads. They are never stopped, so that many short tasks do not restart them.
fn default_pool() -> Result<Arc<ThreadPool>> {
    static POOL: PerProcess<OnceLock<Arc<ThreadPool>>> = PerProcess::new();
    let of_process = POOL.get();
    match of_process.get() {
        Some(pool) => Ok(pool.clone()),
        None => {
            let pool = shared_pool(0)?;
            Ok(of_process.get_or_init(|| pool).clone())
        }
    }
}

/// The shared threads for a number.
fn shared_pool(count: usize) -> Result<Arc<ThreadPool>> {
    /// Pools that somebody holds, by number of threads.
    type Pools = Mutex<Vec<(usize, Weak<ThreadPool>)>>;
    static POOLS: PerProcess<Pools> = PerProcess::new();
    let count = resolve(count)?;
    let mut pools = POOLS.get().lock().unwrap_or_else(PoisonError::into_inner);
    pools.retain(|(_, pool)| pool.strong_count() > 0);
    let known = pools.iter().find(|(of, _)| *of == count).and_then(|(_, pool)| pool.upgrade());
    if let Some(pool) = known {
        return Ok(pool);
    }
    let pool = start(count)?;
    pools.push((count, Arc::downgrade(&pool)));
    Ok(pool)
}

/// A new pool; on WebAssembly that of the calling thread.
fn start(count: usize) -> Result<Arc<ThreadPool>> {
    if cfg!(target_family = "wasm") {
        return calling_thread();
    }
    built(count, ThreadPoolBuilder::new().num_threads(count).thread_name(|i| format!("presight-{i}")))
}

/// The pool that holds the calling thread alone. It starts no thread, and lasts as long as this one.
fn calling_thread() -> Result<Arc<ThreadPool>> {
    thread_local! {
        static POOL: OnceCell<Arc<ThreadPool>> = const { OnceCell::new() };
    }
    POOL.with(|known| match known.get() {
        Some(pool) => Ok(pool.clone()),
        None => {
            let pool = built(1, ThreadPoolBuilder::new().num_threads(1).use_current_thread())?;
            Ok(known.get_or_init(|| pool).clone())
        }
    })
}

fn built(count: usize, threads: ThreadPoolBuilder) -> Result<Arc<ThreadPool>> {
    threads.build().map(Arc::new).map_err(|e| {
        let (what, remedy) =
            (format!("cannot start {count} threads: {e}"), "start fewer `Threads`, or raise ulimit -u");
        Error::new(ErrorKind::System, what, remedy).caused_by(e)
    })
}

/// The number of threads that `count` means; an error if too many.
fn resolve(count: usize) -> Result<usize> {
    match count {
        0 => match std::env::var_os(VARIABLE) {
            Some(text) => from_environment(&text.to_string_lossy()),
            None => Ok(cores()),
        },
        _ => within_limit(count).map_err(|e| e.at(format!("{count} threads"))),
    }
}

/// rayon's own variable.
const VARIABLE: &str = "RAYON_NUM_THREADS";

fn from_environment(text: &str) -> Result<usize> {
    let place = |e: Error| e.at(format!("{VARIABLE}={text}"));
    match text.trim().parse() {
        _ if text.trim().is_empty() => Ok(cores()),
        Ok(0) => Ok(cores()),
        Ok(count) => within_limit(count).map_err(place),
        Err(_) => Err(place(Error::usage("not a valid number of threads", "give one, or 0 for all cores"))),
    }
}

fn within_limit(count: usize) -> Result<usize> {
    let most = limits::MAX_THREADS.max(2 * cores());
    if count > most {
        return Err(Error::usage("too many", format!("give at most {most}, or 0 for all cores")));
    }
    Ok(count)
}

/// The cores that this process may use, by affinity and by the quota of its cgroup; 1 if the system reports none.
pub fn cores() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_same_number_means_the_same_threads_while_somebody_holds_them() {
        let threads = |count: usize| Threads::from(count).started().unwrap().pool.unwrap();
        let five = threads(5);
        assert!(Arc::ptr_eq(&five, &threads(5)));
        assert!(!Arc::ptr_eq(&five, &threads(6)));
        assert!(!Arc::ptr_eq(&five, &Threads::new(5).unwrap().pool.unwrap()));
        assert_eq!(five.current_num_threads(), 5);
        let ended = Arc::downgrade(&five);
        drop(five);
        assert!(ended.upgrade().is_none());
        assert!(Arc::ptr_eq(&threads(0), &threads(0)));
    }

    /// As a fork leaves it: the child has the parent's value, locked by a thread that is gone.
    #[test]
    fn each_process_has_a_value_of_its_own() {
        let values: PerProcess<Mutex<u32>> = PerProcess::new();
        let mut of_parent = values.of(7).lock().unwrap();
        *of_parent = 1;
        *values.of(8).lock().unwrap() = 2;
        *values.of(9).lock().unwrap() += 3;
        assert_eq!([8, 9].map(|process| *values.of(process).lock().unwrap()), [2, 3]);
        drop(of_parent);
        assert_eq!(*values.of(7).lock().unwrap(), 1);
        assert!(std::ptr::eq(values.get(), values.of(std::process::id())));
    }

    #[test]
    fn work_stays_on_the_threads_that_were_given() {
        let name = || std::thread::current().name().map(str::to_owned);
        let threads = Threads::new(3).unwrap();
        let seen =
            threads.run(|| (rayon::current_num_threads(), parallel(rayon::current_num_threads).unwrap(), name()));
        let (count, inner, name) = seen.unwrap();
        assert_eq!((count, inner), (3, 3));
        assert!(name.is_some_and(|name| name.starts_with("presight-")));
        assert_eq!(threads.run(|| parallel_or_here(rayon::current_num_threads)).unwrap(), 3);
    }

    /// What WebAssembly uses for everything.
    #[test]
    fn the_calling_thread_alone_does_all_kinds_of_work() {
        use rayon::prelude::*;
        let work = || {
            let here = std::thread::current().id();
            let pool = calling_thread().unwrap();
            assert!(Arc::ptr_eq(&pool, &calling_thread().unwrap()));
            let threads = Threads { count: 1, pool: Some(pool) };
            let sum = threads.run(|| (0..1000u32).into_par_iter().map(|i| (i, std::thread::current().id())));
            let sum = sum.unwrap().map(|(i, at)| (at == here).then_some(i)).sum::<Option<u32>>();
            let (a, b) = parallel(|| rayon::join(|| 1, || std::thread::current().id())).unwrap();
            let mut later = 0;
            in_place_scope(|scope| scope.spawn(|_| later = 7)).unwrap();
            let inner = threads.run(|| parallel_or_here(rayon::current_num_threads)).unwrap();
            (sum, a, b == here, later, inner)
        };
        assert_eq!(std::thread::spawn(work).join().unwrap(), (Some(499_500), 1, true, 7, 1));
    }

    #[test]
    fn work_aside_has_a_thread_of_its_own_and_the_rest_goes_on() {
        let (sender, receiver) = std::sync::mpsc::channel();
        let mut heard = 0;
        let main = move || {
            sender.send(5).unwrap();
            std::thread::current().name().map(str::to_owned)
        };
        let name = aside("aside", 1 << 20, main, || heard = receiver.recv().unwrap()).unwrap();
        assert_eq!((name.as_deref(), heard), (Some("aside"), 5));
        let e = aside("aside", usize::MAX / 2, || (), || ()).unwrap_err();
        assert_eq!((e.kind(), e.remedy()), (ErrorKind::System, "free some memory"));
    }

    #[test]
    fn too_many_threads_are_refused_at_once() {
        let most = limits::MAX_THREADS.max(2 * cores());
        assert_eq!(within_limit(most).unwrap(), most);
        for count in [most + 1, 100_000, usize::MAX] {
            let e = Threads::new(count).unwrap_err();
            assert_eq!(e.kind(), ErrorKind::Usage, "{e}");
            let e = Threads::from(count).started().unwrap_err();
            assert_eq!(e.to_string(), format!("{count} threads: too many; give at most {most}, or 0 for all cores"));
        }
    }

    #[test]
    fn the_variable_of_rayon_is_read_and_checked() {
        assert_eq!(from_environment("3").unwrap(), 3);
        assert_eq!(from_environment("0").unwrap(), cores());
        assert_eq!(from_environment("").unwrap(), cores());
        for text in ["-1", "two", "100000", "99999999999999999999"] {
            let e = from_environment(text).unwrap_err();
            assert_eq!(e.kind(), ErrorKind::Usage);
            assert!(e.to_string().starts_with(&format!("RAYON_NUM_THREADS={text}: ")), "{e}");
        }
    }
}
