//! Files of one prediction are written while the next is made.

use presight::{Error, ErrorKind, Result};
use std::sync::mpsc;
use std::thread;

/// Makes a value for each number, and writes each, in the same order, on a thread of its own. `make` gets back a value that was
/// written, whose memory it can take; there are never more than two.
///
/// # Errors
/// The first of `write`, after which nothing more is made or written; else that of `make`, when all before it is written;
/// [`ErrorKind::System`] if there is no thread to be had.
pub fn make_and_write<T: Send>(
    mut numbers: impl Iterator<Item = usize>,
    mut make: impl FnMut(usize, Option<T>) -> Result<T>,
    mut write: impl FnMut(usize, &mut T) -> Result<()> + Send,
) -> Result<()> {
    // Without room between the threads: a value waits until the one before it is written.
    let (made, to_write) = mpsc::sync_channel::<(usize, T)>(0);
    let (written, to_use) = mpsc::channel();
    thread::scope(|scope| {
        let write_all = move || {
            to_write.into_iter().try_for_each(|(number, mut value)| {
                write(number, &mut value)?;
                // Nobody takes the last ones.
                let _ = written.send(value);
                Ok(())
            })
        };
        let writer = thread::Builder::new().name("presight-writer".into()).spawn_scoped(scope, write_all);
        let writer = writer.map_err(|e| {
            let remedy = "give --threads 1, or raise ulimit -u";
            Error::new(ErrorKind::System, format!("cannot start a thread: {e}"), remedy).caused_by(e)
        })?;
        let all_made = numbers.try_for_each(|number| {
            let value = make(number, to_use.try_recv().ok())?;
            // The writer is gone after an error, which is returned below.
            made.send((number, value)).map_err(|_| Error::usage("nothing is written any more", ""))
        });
        drop(made);
        let all_written = writer.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        all_written.and(all_made)
    })
}

/// The same on the caller's thread alone.
///
/// # Errors
/// The first of `make` or `write`.
pub fn make_then_write<T>(
    mut numbers: impl Iterator<Item = usize>,
    mut make: impl FnMut(usize, Option<T>) -> Result<T>,
    mut write: impl FnMut(usize, &mut T) -> Result<()>,
) -> Result<()> {
    let mut last = None;
    numbers.try_for_each(|number| {
        let mut value = make(number, last.take())?;
        write(number, &mut value)?;
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
        let write = |number: usize, made: &mut (usize, usize)| {
            values.insert(made.0);
            written.push((number, made.1));
            Ok(())
        };
        make_and_write(3..200, make, write).unwrap();
        assert_eq!(written, (3..200).map(|n| (n, 10 * n)).collect::<Vec<_>>());
        assert!(count <= 2 && values.len() == count, "{count}");
    }

    #[test]
    fn an_error_of_writing_ends_both() {
        let (mut made, mut written) = (Vec::new(), Vec::new());
        let make = |number: usize, _| {
            made.push(number);
            Ok(number)
        };
        let write = |number: usize, _: &mut usize| {
            written.push(number);
            if number == 4 { refuse(number) } else { Ok(()) }
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
            let write = |number: usize, _: &mut usize| {
                written.push(number);
                Ok(())
            };
            let run = if threads == 1 { make_then_write(0..9, make, write) } else { make_and_write(0..9, make, write) };
            assert!(run.unwrap_err().to_string().contains("number 5"));
            assert_eq!(written, [0, 1, 2, 3, 4]);
        }
    }
}
