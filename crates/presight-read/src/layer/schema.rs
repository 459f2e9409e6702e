//! The JSON schema of layer files.

/// The JSON schema (draft 2020-12) of layer files, for editors and for tools that write layers.
///
/// It defines types, keys and ranges. [`super::read`] also checks rules that a schema cannot express: covariances
/// without negative eigenvalues, convex patches, square fiducials, unique ids.
///
/// ```
/// let schema: serde_json::Value = serde_json::from_str(presight::files::layer_schema())?;
/// assert_eq!(schema["properties"]["format"]["anyOf"][1]["const"], 2);
/// # Ok::<(), serde_json::Error>(())
/// ```
pub fn schema() -> &'static str {
    include_str!("layer.schema.json")
}
