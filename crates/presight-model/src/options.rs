//! Setters of options.

/// Makes a `with_..` for each option. Structs of options are `#[non_exhaustive]`, so other crates start from a default
/// and set what differs.
#[macro_export]
macro_rules! with_options {
    ($options:ty: $($with:ident $field:ident: $kind:ty),+ $(,)?) => {
        impl $options {
            $(
                #[doc = concat!("Sets [`Self::", stringify!($field), "`].")]
                #[must_use]
                pub fn $with(self, $field: $kind) -> Self {
                    Self { $field, ..self }
                }
            )+
        }
    };
}
