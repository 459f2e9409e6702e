//! A writer killed at random moments.

use super::{create, numbered, presight, small};
use presight::World;
use presight::store;
use std::io::{BufWriter, Read, Write};
use std::process::Stdio;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

/// The kills run in parallel, because most of the time is spent waiting for the disk.
const KILLS: u64 = 26;
const WORKERS: u64 = 4;

#[test]
fn a_killed_writer_leaves_a_prefix_of_its_changes() {
    let workers: Vec<_> = (0..WORKERS).map(|seed| std::thread::spawn(move || kill_again_and_again(seed))).collect();
    workers.into_iter().for_each(|worker| worker.join().unwrap());
}

fn kill_again_and_again(seed: u64) {
    let folder = tempfile::tempdir().unwrap();
    let path = create(folder.path(), &small());
    let mut expected = World::new(small());
    let (mut done, mut killed_midway) = (0u64, 0);
    for round in 0..KILLS {
        let mut command = presight();
        command.args(["env", "apply"]).arg(&path).arg("-").stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut child = command.spawn().unwrap();
        let sent = Arc::new(AtomicU64::new(0));
        let (counter, mut stdin) = (sent.clone(), BufWriter::with_capacity(1 << 12, child.stdin.take().unwrap()));
        // Steps of several sizes also give batches of several changes.
        let step = 1 + round % 40;
        let writer = std::thread::spawn(move || {
            for k in done + 1.. {
                counter.fetch_add(1, Ordering::SeqCst);
                let flush = k % step == 0;
                if writeln!(stdin, "{}", numbered(k).1).is_err() || (flush && stdin.flush().is_err()) {
                    break;
                }
            }
        });
        let mut stdout = child.stdout.take().unwrap();
        let mut first = [0; 1];
        // Kills at random moments after the first acknowledgement.
        let alive = stdout.read(&mut first).unwrap() == 1;
        assert!(alive, "round {round}: {:?}", child.wait());
        std::thread::sleep(Duration::from_micros((round * WORKERS + seed) * 7919 % 20_000));
        child.kill().unwrap();
        let mut acks = String::new();
        stdout.read_to_string(&mut acks).unwrap();
        child.wait().unwrap();
        writer.join().unwrap();
        let whole_lines = acks.rfind('\n').map_or("", |end| &acks[..end]);
        let last = whole_lines.lines().last().map_or(0, |line| line.rsplit(' ').next().unwrap().parse().unwrap());

        let info = store::check(&path).unwrap();
        let n = info.changes;
        assert!(n >= done + last, "round {round}: {n} changes, {last} acknowledged after {done}");
        assert!(n <= done + sent.load(Ordering::SeqCst), "round {round}: {n} changes");
        for k in done + 1..=n {
            expected.apply(numbered(k).0).unwrap();
        }
        let (is, should) = (info.environment.content_hash(), expected.environment().content_hash());
        assert_eq!(is, should, "round {round}: the state differs from that after {n} changes");
        killed_midway += u64::from(n > done);
        done = n;
    }
    assert!(killed_midway > KILLS / 2, "{killed_midway} rounds changed something");
}
