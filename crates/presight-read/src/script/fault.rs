//! Converts Rhai's errors to ours, with file, line, column, call and remedy.

use super::call::Function;
use super::functions::signatures;
use super::meter::EndReason;
use super::tokens::Excess;
use presight_model::error::{Error, ErrorKind};
use presight_model::limits;
use rhai::{Dynamic, EvalAltResult, ParseError, ParseErrorType, Position};
use std::collections::BTreeMap;
use std::rc::Rc;

/// One of our errors while it passes through a script, which may catch it.
#[derive(Clone)]
pub(super) struct Fault(Rc<Error>, Option<&'static Function>);

impl Fault {
    /// An error in a call of a function of presight.
    pub fn in_call(e: Error, function: &'static Function, at: Position) -> Box<EvalAltResult> {
        EvalAltResult::ErrorRuntime(Dynamic::from(Self(Rc::new(e), Some(function))), at).into()
    }

    /// An error in an operator.
    pub fn bare(e: Error) -> Box<EvalAltResult> {
        Self::at(e, Position::NONE)
    }

    /// An error at a position.
    pub fn at(e: Error, at: Position) -> Box<EvalAltResult> {
        EvalAltResult::ErrorRuntime(Dynamic::from(Self(Rc::new(e), None)), at).into()
    }

    /// The text that a script can print when it catches the error.
    pub fn message(&mut self) -> String {
        self.0.to_string()
    }
}

/// Texts of the scripts read so far, by their names in errors.
pub(super) type Sources = BTreeMap<String, String>;

/// Maximum number of callers listed in an error.
const LISTED_CALLERS: usize = 3;

/// Converts an error of Rhai to ours. `script` is the main file.
pub(super) fn explain(error: EvalAltResult, script: &str, sources: &Sources) -> Error {
    let mut callers = Vec::new();
    let (mut file, mut error, mut outer) = (script.to_owned(), error, Position::NONE);
    loop {
        let at = error.position();
        let at = if at.is_none() { outer } else { at };
        match error {
            EvalAltResult::ErrorInFunctionCall(name, source, inner, _) => {
                callers.push(format!("{name} called at {}", place_of(&file, script, at)));
                file = if source.is_empty() { file } else { source };
                (error, outer) = (*inner, Position::NONE);
            }
            EvalAltResult::ErrorInModule(source, inner, _) => {
                callers.push(format!("imported at {}", place_of(&file, script, at)));
                (file, error, outer) = (source, *inner, Position::NONE);
            }
            leaf => {
                let text = sources.get(&file).map(String::as_str);
                return whole(&leaf, at, &file, text, &callers);
            }
        }
    }
}

/// A place in the list of callers. The main file is not named.
fn place_of(file: &str, script: &str, at: Position) -> String {
    let line = at.line().unwrap_or(0);
    if file == script { format!("line {line}") } else { format!("{file}, line {line}") }
}

fn whole(leaf: &EvalAltResult, at: Position, file: &str, text: Option<&str>, callers: &[String]) -> Error {
    let (kind, what, remedy, function) = in_words(leaf);
    let mut place = match (at.line(), at.position()) {
        (Some(line), Some(column)) => format!("line {line}, column {column}"),
        (Some(line), None) => format!("line {line}"),
        // Rhai does not report the positions of some steps.
        _ => "at an unknown line".to_owned(),
    };
    let call = function.map(str::to_owned).or_else(|| text.and_then(|text| name_at(text, at)));
    if let Some(call) = call {
        place += &format!(", in the call of {call}");
    }
    for caller in callers.iter().rev().take(LISTED_CALLERS) {
        place += &format!(", in {caller}");
    }
    Error::new(kind, what, remedy).at(place).in_file(file)
}

/// The name of the function called at a position of the text, if there is a call.
fn name_at(text: &str, at: Position) -> Option<String> {
    let line = text.lines().nth(at.line()?.checked_sub(1)?)?;
    let from: String = line.chars().skip(at.position()?.checked_sub(1)?).collect();
    let name: String = from.chars().take_while(|c| c.is_alphanumeric() || matches!(c, '_' | ':')).collect();
    let called = from[name.len()..].trim_start().starts_with('(');
    (called && !name.is_empty() && !["if", "while", "switch", "for", "return"].contains(&name.as_str())).then_some(name)
}

/// Kind, message, remedy, and which of our functions reported the error.
fn in_words(leaf: &EvalAltResult) -> (ErrorKind, String, String, Option<&'static str>) {
    use EvalAltResult as E;
    let invalid = |what: String, remedy: &str| (ErrorKind::Invalid, what, remedy.to_owned(), None);
    match leaf {
        E::ErrorRuntime(value, _) => match value.read_lock::<Fault>() {
            Some(fault) => {
                let Fault(e, function) = &*fault;
                let function = function.map(Function::name);
                let what = e.to_string();
                // An error's text already contains the remedy.
                let remedy = e.remedy().to_owned();
                let what = what.strip_suffix(&format!("; {remedy}")).map(str::to_owned).unwrap_or(what);
                (e.kind(), what, remedy, function)
            }
            None => invalid(format!("the script throws {}", shortened(&value.to_string())), "see the script"),
        },
        E::ErrorFunctionNotFound(signature, _) => unknown_function(signature),
        E::ErrorTooManyOperations(_) => ended(EndReason::Operations),
        E::ErrorTerminated(why, _) => ended(why.clone().try_cast().unwrap_or(EndReason::Clock)),
        E::ErrorStackOverflow(_) => invalid(
            format!("calls nest over {} levels", limits::MAX_SCRIPT_CALLS),
            "look for a function that calls itself without end",
        ),
        E::ErrorTooManyVariables(_) => {
            invalid(format!("over {} variables", limits::MAX_SCRIPT_VARIABLES), "keep many values in an array")
        }
        E::ErrorTooManyModules(_) => invalid(format!("over {} modules", limits::MAX_SCRIPT_MODULES), "join some"),
        E::ErrorDataTooLarge(what, _) => invalid(
            format!("{} is over the limit", what.trim().to_lowercase()),
            &format!(
                "strings may have {} bytes, arrays {} elements, maps {} entries",
                limits::MAX_SCRIPT_STRING,
                limits::MAX_SCRIPT_ARRAY,
                limits::MAX_SCRIPT_MAP
            ),
        ),
        E::ErrorParsing(e, _) => invalid(format!("syntax error: {e}"), "scenes/README.md shows the language"),
        E::ErrorVariableNotFound(name, _) => {
            invalid(format!("there is no variable {name:?}"), "functions see only their parameters: pass it as one")
        }
        other => {
            let text = other.to_string();
            let what = text.split(" (line ").next().unwrap_or(&text).to_owned();
            invalid(shortened(&what), "correct the script")
        }
    }
}

fn ended(why: EndReason) -> (ErrorKind, String, String, Option<&'static str>) {
    let what = match why {
        EndReason::Operations => format!("the script takes over {} operations", limits::MAX_SCRIPT_OPERATIONS),
        EndReason::Clock => format!("the script takes over {} s", limits::MAX_SCRIPT_SECONDS),
    };
    let remedy =
        "look for an endless loop, and for large arrays that are read often; make parts once and place them often";
    (ErrorKind::Invalid, what, remedy.to_owned(), None)
}

/// Shortens a text so that a message with it fits a line.
pub(super) fn shortened(text: &str) -> String {
    const LONGEST: usize = 200;
    match text.char_indices().nth(LONGEST) {
        None => text.to_owned(),
        Some((end, _)) => format!("{}.. ({} bytes)", &text[..end], text.len()),
    }
}

fn unknown_function(signature: &str) -> (ErrorKind, String, String, Option<&'static str>) {
    let name = signature.split(['(', ' ']).next().unwrap_or_default();
    let ways = signatures(name);
    if ways.is_empty() {
        let remedy = "scenes/README.md lists the functions".to_owned();
        return (ErrorKind::Invalid, format!("there is no function {signature}"), remedy, None);
    }
    let given = signature.split_once('(').map_or("", |(_, rest)| rest.trim_end_matches(')'));
    let count = given.split(',').filter(|a| !a.trim().is_empty()).count();
    let what = format!("{name} is called with {count} argument{}", if count == 1 { "" } else { "s" });
    (ErrorKind::Invalid, what, format!("call it as {}", ways.join(" or ")), None)
}

/// Converts a parsing error to ours.
pub(super) fn syntax(e: &ParseError) -> Error {
    let what = match e.err_type() {
        ParseErrorType::ExprTooDeep => Excess::Nesting.in_words().0,
        // Anonymous functions count too.
        ParseErrorType::TooManyFunctions => Excess::Functions.in_words().0,
        other => format!("syntax error: {}", shortened(&other.to_string())),
    };
    let at = e.position();
    let place = match (at.line(), at.position()) {
        (Some(line), Some(column)) => format!("line {line}, column {column}"),
        _ => "at its end".to_owned(),
    };
    Error::invalid(what, "scenes/README.md shows the language").at(place)
}
