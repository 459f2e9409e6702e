//! Limits of scripts: Rhai's own, and a count of operations weighted by their cost.

use presight_model::clock::Instant;
use presight_model::limits;
use rhai::{Dynamic, Engine, EvalAltResult, FnPtr, Position};
use std::cell::Cell;
use std::rc::Rc;
use std::time::Duration;

/// Why a script was ended; Rhai's error carries it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum EndReason {
    /// The limit on operations.
    Operations,
    /// The time limit.
    Clock,
}

/// Reading this many array elements, half as many map entries, or 256 bytes of strings is one operation.
const READ: usize = 16;
/// Operations between two checks of the clock.
const LOOK: u64 = 256;
/// After a limit is exceeded, at most this many steps may pass until the next variable is read, which ends the script.
/// Rhai knows the position of every variable, but not of some steps, such as indexing.
const GRACE: u64 = 1024;

/// Sets all limits.
///
/// Rhai counts its own steps, but not the work within a step. Comparing two arrays calls `==` for each pair of elements
/// on a copy of the count, and reading a variable copies its value. So we count each step that Rhai reports, and each
/// large value that a script reads. Rhai does not report `this`, `global::` and variables of modules. Our scripts
/// cannot use the first two, and the last are small ([`is_exportable`]). The clock stops during `busy`, the time spent
/// in our own functions, which count their work themselves.
pub(super) fn limit(engine: &mut Engine, busy: Rc<Cell<Duration>>) {
    engine
        // Our count is never lower, so it ends the script first.
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
    #[expect(deprecated, reason = "not deprecated, only unstable")]
    engine.on_var(move |name, _, context| {
        // Rhai adds the position of the variable to the error.
        if let Some(why) = ended.get() {
            return Err(EvalAltResult::ErrorTerminated(Dynamic::from(why), Position::NONE).into());
        }
        let Some(value) = context.scope().get(name) else { return Ok(None) };
        // Rhai checks its own size limits in calls, but not when an entry is set.
        if let Some(what) = too_large(value) {
            return Err(EvalAltResult::ErrorDataTooLarge(what.to_owned(), Position::NONE).into());
        }
        steps.set(steps.get() + (size(value) / READ) as u64);
        Ok(None)
    });
}

/// True for a value small enough to be copied at every step.
pub(super) fn is_exportable(value: &Dynamic) -> bool {
    size(value) <= limits::MAX_SCRIPT_EXPORT
}

/// The size that exceeds a limit, in Rhai's words.
fn too_large(value: &Dynamic) -> Option<&'static str> {
    if let Ok(array) = value.as_array_ref() {
        return (array.len() > limits::MAX_SCRIPT_ARRAY).then_some("Size of array");
    }
    if let Ok(map) = value.as_map_ref() {
        return (map.len() > limits::MAX_SCRIPT_MAP).then_some("Size of object map");
    }
    // Rhai does not limit the values that `curry` binds to a function.
    let curried = value.read_lock::<FnPtr>().is_some_and(|f| curried(&f) > limits::MAX_SCRIPT_ARRAY);
    curried.then_some("Size of the array of curried values")
}

/// The cost of reading the values that `curry` bound to a function.
fn curried(function: &FnPtr) -> usize {
    function.iter_curry().map(|value| 1 + size(value)).sum()
}

/// The approximate cost of reading a value.
fn size(value: &Dynamic) -> usize {
    if value.is_int() || value.is_float() || value.is_bool() {
        return 0;
    }
    if let Ok(array) = value.as_array_ref() {
        return array.len() + array.iter().map(size).sum::<usize>();
    }
    if let Ok(map) = value.as_map_ref() {
        // Reading a map searches or copies its keys.
        return map.iter().map(|(key, value)| 2 + key.len() / 16 + size(value)).sum();
    }
    if let Some(function) = value.read_lock::<FnPtr>() {
        return curried(&function);
    }
    value.as_immutable_string_ref().map_or(0, |text| text.len() / 16)
}
