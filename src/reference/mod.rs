//! The reference: a plain z-buffer in f64 that the engines are held to.
