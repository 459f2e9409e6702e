//! The `presight` command; everything is in the library of this crate.

use std::process::ExitCode;

fn main() -> ExitCode {
    presight_cli::main()
}
