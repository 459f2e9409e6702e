//! Handling of signals that end the process.

/// Installs signal handlers: SIGINT and SIGTERM remove half-written files before the process ends, and a write beyond
/// the file size limit fails with an error, as on a full disk.
#[cfg(unix)]
pub fn listen() {
    use signal_hook::consts::{SIGINT, SIGTERM, SIGXFSZ};
    use signal_hook::{flag, low_level};
    use std::io::Read;
    use std::os::unix::net::UnixStream;
    use std::sync::Arc;
    use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

    // A handler for SIGXFSZ makes the write fail; nobody reads the flag. If a step below fails, default actions remain.
    let _ = flag::register(SIGXFSZ, Arc::<AtomicBool>::default());
    let Ok((mut told, tell)) = UnixStream::pair() else { return };
    let last = Arc::new(AtomicUsize::new(0));
    let signal = Arc::clone(&last);
    let wait = move || {
        // Fails without a byte once all senders are dropped.
        if told.read_exact(&mut [0]).is_ok() {
            let _nothing_new = presight::tools::abandon_files();
            let _ = low_level::emulate_default_handler(signal.load(Ordering::Relaxed) as i32);
        }
    };
    // Start the thread before registering handlers: without it a signal would have no effect.
    if std::thread::Builder::new().name("signals".into()).spawn(wait).is_err() {
        return;
    }
    for signal in [SIGINT, SIGTERM].into_iter().filter(|s| !is_ignored(*s)) {
        let Ok(tell) = tell.try_clone() else { return };
        let _ = flag::register_usize(signal, Arc::clone(&last), signal as usize);
        let _ = low_level::pipe::register(signal, tell);
    }
}

#[cfg(not(unix))]
pub fn listen() {}

/// Returns true if this process ignores the signal. Shells start background processes with SIGINT ignored.
#[cfg(unix)]
fn is_ignored(signal: i32) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    mask.and_then(|m| u64::from_str_radix(m.trim(), 16).ok()).is_some_and(|m| m >> (signal - 1) & 1 == 1)
}
