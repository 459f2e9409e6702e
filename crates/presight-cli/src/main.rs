//! The `presight` command. Its code is in this crate's library.

use std::process::ExitCode;

fn main() -> ExitCode {
    presight_cli::main()
}
