//! The JSON schema of layer files.

/// JSON schema (draft 2020-12) of a layer file, for editors and for tools that make layers.
///
/// It tells types, keys and ranges. What it cannot tell (covariances without negative eigenvalues, convex patches,
/// square fiducials, ids used once) is checked by [`super::read`].
///
/// ```
/// let schema: serde_json::Value = serde_json::from_str(presight::io::layer::schema())?;
/// assert_eq!(schema["properties"]["format"]["const"], 1);
/// # Ok::<(), serde_json::Error>(())
/// ```
pub fn schema() -> &'static str {
    include_str!("layer.schema.json")
}
