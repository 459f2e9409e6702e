//! What a script may take: the language's own limits, and operations counted by what they cost.

use presight_model::limits;
use rhai::{Dynamic, Engine, EvalAltResult, FnPtr, Position};
use std::cell::Cell;
use std::rc::Rc;
use std::time::{Duration, Instant};

/// Why a script was ended, as the language's error carries it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum EndReason {
    /// By the limit on operations.
    Operations,
    /// By the clock.
    Clock,
}

/// Elements of arrays, half as many of maps, or 256 bytes of strings, that are read for one operation.
const READ: usize = 16;
/// Operations between two looks at the clock.
const LOOK: u64 = 256;
/// Steps after the end within which a variable is waited for: the language knows no place of some steps, such as indexing, but
/// that of every variable.
const GRACE: u64 = 1024;

/// Sets all limits.
///
/// The language counts its own steps, but not what is done within one: comparing two arrays calls `==` for each pair of
/// elements, on a copy of the count, and reading a variable copies its value. So each step that is told of counts here, and each
/// large value that is read. It does not tell of `this`, of `global::` and of the variables of modules: the first two are no
/// part of our language, and the last are small ([`is_exportable`]). `busy` is the time in functions that count what they do
/// themselves: the clock does not run then.
pub(super) fn limit(engine: &mut Engine, busy: Rc<Cell<Duration>>) {
    engine
        // Ours ends the script first, for it counts no less.
        .set_max_operations(limits::MAX_SCRIPT_OPERATIONS + 2 * GRACE)
        .set_max_call_levels(limits::MAX_SCRIPT_CALLS)
        .set_max_expr_depths(limits::MAX_SCRIPT_NESTING, limits::MAX_SCRIPT_NESTING)
        .set_max_variables(limits::MAX_SCRIPT_VARIABLES)
        .set_max_functions(limits::MAX_SCRIPT_FUNCTIONS)
        .set_max_modules(limits::MAX_SCRIPT_MODULES)
        .set_max_string_size(limits::MAX_SCRIPT_STRING)
        .set_max_array_size(limits::MAX_SCRIPT_ARRAY)
        .set_max_map_size(limits::MAX_SCRIPT_MAP);
    let steps = Rc::new(Cell::new(0u64));
    let start = Instant::now();
    let (counted, ended) = (steps.clone(), Rc::new(Cell::new(None)));
    let (end, grace) = (ended.clone(), Cell::new(GRACE));
    engine.on_progress(move |_| {
        let now = counted.get() + 1;
        counted.set(now);
        let late = || start.elapsed() > Duration::from_secs(limits::MAX_SCRIPT_SECONDS) + busy.get();
        match now {
            _ if end.get().is_some() => {}
            _ if now > limits::MAX_SCRIPT_OPERATIONS => end.set(Some(EndReason::Operations)),
            _ if now.is_multiple_of(LOOK) && late() => end.set(Some(EndReason::Clock)),
            _ => {}
        }
        let why = end.get()?;
        grace.set(grace.get().saturating_sub(1));
        (grace.get() == 0).then(|| Dynamic::from(why))
    });
    #[expect(deprecated, reason = "it is not, the library says: it may change")]
    engine.on_var(move |name, _, context| {
        // The language adds the place of the variable to errors.
        if let Some(why) = ended.get() {
            return Err(EvalAltResult::ErrorTerminated(Dynamic::from(why), Position::NONE).into());
        }
        let Some(value) = context.scope().get(name) else { return Ok(None) };
        // Its own limit is kept by calls only, not where an entry is set.
        if let Some(what) = too_large(value) {
            return Err(EvalAltResult::ErrorDataTooLarge(what.to_owned(), Position::NONE).into());
        }
        steps.set(steps.get() + (size(value) / READ) as u64);
        Ok(None)
    });
}

/// True for a value that may be copied at every step.
pub(super) fn is_exportable(value: &Dynamic) -> bool {
    size(value) <= limits::MAX_SCRIPT_EXPORT
}

/// What of a value is over the limits, in the language's words.
fn too_large(value: &Dynamic) -> Option<&'static str> {
    if let Ok(array) = value.as_array_ref() {
        return (array.len() > limits::MAX_SCRIPT_ARRAY).then_some("Size of array");
    }
    if let Ok(map) = value.as_map_ref() {
        return (map.len() > limits::MAX_SCRIPT_MAP).then_some("Size of object map");
    }
    // Nothing else holds what `curry` gives to a function.
    let curried = value.read_lock::<FnPtr>().is_some_and(|f| curried(&f) > limits::MAX_SCRIPT_ARRAY);
    curried.then_some("Size of the array of curried values")
}

/// What reading the values costs that `curry` gave to a function.
fn curried(function: &FnPtr) -> usize {
    function.iter_curry().map(|value| 1 + size(value)).sum()
}

/// What reading a value costs, about.
fn size(value: &Dynamic) -> usize {
    if value.is_int() || value.is_float() || value.is_bool() {
        return 0;
    }
    if let Ok(array) = value.as_array_ref() {
        return array.len() + array.iter().map(size).sum::<usize>();
    }
    if let Ok(map) = value.as_map_ref() {
        // Its keys are looked for, or copied.
        return map.iter().map(|(key, value)| 2 + key.len() / 16 + size(value)).sum();
    }
    if let Some(function) = value.read_lock::<FnPtr>() {
        return curried(&function);
    }
    value.as_immutable_string_ref().map_or(0, |text| text.len() / 16)
}
