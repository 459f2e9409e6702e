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

/// Declares a struct of options with its defaults, and a `with_..` for each option. Other crates start from the default
/// and set what differs.
///
/// ```
/// presight_model::options! {
///     /// Options of a walk.
///     #[derive(Clone, Copy, Debug, PartialEq)]
///     pub struct WalkOptions {
///         /// Length of a step, metres.
///         step: f64 = 0.7, with_step;
///     }
/// }
/// assert_eq!(WalkOptions::default().with_step(0.5).step, 0.5);
/// ```
#[macro_export]
macro_rules! options {
    ($(#[$meta:meta])* pub struct $name:ident {
        $($(#[$doc:meta])* $field:ident: $kind:ty = $default:expr, $with:ident;)+
    }) => {
        $(#[$meta])*
        #[non_exhaustive]
        pub struct $name {
            $($(#[$doc])* pub $field: $kind,)+
        }

        impl Default for $name {
            fn default() -> Self {
                Self { $($field: $default),+ }
            }
        }

        $crate::with_options!($name: $($with $field: $kind),+);
    };
}
