//! Writes the files of one prediction while the next one is computed.

use presight::{Error, ErrorKind, Result};
use std::sync::mpsc;
use std::thread;

/// Makes a value of each item, and writes the values in the same order on a second thread. `make` receives a value that
/// has been written, to reuse its memory; at most two values exist. The next item is taken while a value is written.
///
/// # Errors
/// The first error of `write`, after which nothing more is made or written. Otherwise the error of `make`, after all
/// earlier values have been written. [`ErrorKind::System`] if the thread cannot be started.
pub fn make_and_write<N, T: Send>(
    mut items: impl Iterator<Item = N>,
    mut make: impl FnMut(N, Option<T>) -> Result<T>,
    mut write: impl FnMut(&mut T) -> Result<()> + Send,
) -> Result<()> {
    // A rendezvous channel: a value waits until the one before it has been written.
    let (made, to_write) = mpsc::sync_channel::<T>(0);
    let (written, to_use) = mpsc::channel();
    thread::scope(|scope| {
        let write_all = move || {
            to_write.into_iter().try_for_each(|mut value| {
                write(&mut value)?;
                // Nobody receives the last ones.
                let _ = written.send(value);
                Ok(())
            })
        };
        let writer = thread::Builder::new().name("presight-writer".into()).spawn_scoped(scope, write_all);
        let writer = writer.map_err(|e| {
            let remedy = "give --threads 1, or raise ulimit -u";
            Error::new(ErrorKind::System, format!("cannot start a thread: {e}"), remedy).caused_by(e)
        })?;
        let all_made = items.try_for_each(|item| {
            let value = make(item, to_use.try_recv().ok())?;
            // The writer stops after an error, which is returned below.
            made.send(value).map_err(|_| Error::usage("the writer has stopped", ""))
        });
        drop(made);
        let all_written = writer.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        all_written.and(all_made)
    })
}

/// As [`make_and_write`], on the caller's thread.
///
/// # Errors
/// The first error of `make` or `write`.
pub fn make_then_write<N, T>(
    mut items: impl Iterator<Item = N>,
    mut make: impl FnMut(N, Option<T>) -> Result<T>,
    mut write: impl FnMut(&mut T) -> Result<()>,
) -> Result<()> {
    let mut last = None;
    items.try_for_each(|item| {
        let mut value = make(item, last.take())?;
        write(&mut value)?;
        last = Some(value);
        Ok(())
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashSet;

    fn refuse(number: usize) -> Result<()> {
        Err(Error::usage(format!("number {number}"), "none"))
    }

    #[test]
    fn everything_is_written_in_order_with_two_values_at_most() {
        let (mut count, mut written, mut values) = (0, Vec::new(), HashSet::new());
        let make = |number: usize, old: Option<(usize, usize)>| {
            let (value, _) = old.unwrap_or_else(|| {
                count += 1;
                (count, 0)
            });
            Ok((value, 10 * number))
        };
        let write = |made: &mut (usize, usize)| {
            values.insert(made.0);
            written.push(made.1);
            Ok(())
        };
        make_and_write(3..200, make, write).unwrap();
        assert_eq!(written, (3..200).map(|n| 10 * n).collect::<Vec<_>>());
        assert!(count <= 2 && values.len() == count, "{count}");
    }

    #[test]
    fn an_error_of_writing_ends_both() {
        let (mut made, mut written) = (Vec::new(), Vec::new());
        let make = |number: usize, _| {
            made.push(number);
            Ok(number)
        };
        let write = |number: &mut usize| {
            written.push(*number);
            if *number == 4 { refuse(*number) } else { Ok(()) }
        };
        let e = make_and_write(0..100, make, write).unwrap_err();
        assert!(e.to_string().contains("number 4"), "{e}");
        assert_eq!(written, [0, 1, 2, 3, 4]);
        assert!(made.len() <= 7, "{made:?}");
    }

    #[test]
    fn what_was_made_before_an_error_is_written() {
        for threads in [1, 2] {
            let mut written = Vec::new();
            let make = |number: usize, _| if number == 5 { refuse(number).map(|()| 0) } else { Ok(number) };
            let write = |number: &mut usize| {
                written.push(*number);
                Ok(())
            };
            let run = if threads == 1 { make_then_write(0..9, make, write) } else { make_and_write(0..9, make, write) };
            assert!(run.unwrap_err().to_string().contains("number 5"));
            assert_eq!(written, [0, 1, 2, 3, 4]);
        }
    }
}
