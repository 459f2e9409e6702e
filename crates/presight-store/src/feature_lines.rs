//! Changes of features as lines of `presight env apply`, for programs that keep steps before they are stored.

use super::context::Context;
use super::line::Line;
use super::op::Op;
use presight_model::change::Change;
use presight_model::environment::Environment;
use presight_model::error::{Error, Result};
use std::sync::Arc;

/// A change of features as one line of JSON.
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`] for a change that inserts an object.
pub fn feature_line(change: &Change) -> Result<String> {
    let op = Op::of(change, &mut |_| Err(not_of_features()))?;
    serde_json::to_string(&op).map_err(|e| Error::invalid("the change cannot be written as JSON", "").caused_by(e))
}

/// The change of a line: the insertion, alteration, restoration or deletion of features, the tolerance of their layer,
/// or a group of these. Its `cause` and `id` have no effect.
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`] for another change, and for a feature that is not valid.
pub fn feature_change(line: &str, environment: &Arc<Environment>) -> Result<Change> {
    let op = Line::parse(line)?.op;
    if !is_of_features(&op) {
        return Err(not_of_features());
    }
    Context::new(environment, None, &mut |_| Err(not_of_features())).change(op)
}

fn is_of_features(op: &Op) -> bool {
    match op {
        Op::InsertFeature { .. }
        | Op::SetFeature { .. }
        | Op::RestoreFeature { .. }
        | Op::DeleteFeature { .. }
        | Op::SetTolerance { .. } => true,
        Op::Group { changes } => changes.iter().all(is_of_features),
        _ => false,
    }
}

fn not_of_features() -> Error {
    let remedy = "give insert_feature, set_feature, restore_feature, delete_feature, or a group of these";
    Error::invalid("the change is not one of features alone", remedy)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_of_features_read_back_and_others_are_refused() {
        let environment = Arc::new(Environment::new());
        let inserted =
            r#"{"op":"insert_feature","class":"video","feature":{"id":3,"kind":"point","points":[[1.0,0.1,-0.0]]}}"#;
        let deleted = r#"{"op":"delete_feature","class":"video","feature":2}"#;
        let line = format!(r#"{{"op":"group","changes":[{inserted},{deleted}]}}"#);
        let change = feature_change(&line, &environment).unwrap();
        assert_eq!(feature_line(&change).unwrap(), line);
        let caused = line.replacen('{', r#"{"cause":"edit","#, 1);
        assert_eq!(feature_line(&feature_change(&caused, &environment).unwrap()).unwrap(), line);
        for other in [
            r#"{"op":"delete_object","object":"door"}"#,
            r#"{"op":"group","changes":[{"op":"move","object":"a","pose":[0,0,0,0,0,0]}]}"#,
            r#"{"op":"delete_feature","class":"video","feature":2,"feature":3}"#,
            r#"{"op":"insert_feature","class":"video","feature":{"id":3,"kind":"point","points":[[1,2]]}}"#,
            "[]",
            "",
        ] {
            let e = feature_change(other, &environment).unwrap_err();
            assert!(!e.remedy().is_empty(), "{other}: {e}");
        }
    }
}
