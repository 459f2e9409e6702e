//! The log: every change with its time and cause. The hash of each entry covers the entry before it.

use super::hash::{Field, Hash, of_row};
use super::op::{KeySets, Op};
use super::read::get;
use super::rows::{Meta, from_json};
use super::schema::{FORMAT, damaged, refusal};
use presight_model::error::{Error, Result};
use rusqlite::{Connection, Row};
use std::collections::BTreeSet;
use std::path::Path;

/// An entry of the log.
#[derive(Clone, Debug, PartialEq)]
pub struct LogEntry {
    /// Its number, from 1.
    pub number: u64,
    /// Time given by the caller, UTC seconds.
    pub time: f64,
    /// Why the change was made.
    pub cause: String,
    /// The caller's own id. A change with the same id is not applied twice.
    pub id: Option<String>,
    /// The entry that this one undoes.
    pub undoes: Option<u64>,
    /// The change, as JSON.
    pub change: String,
    /// The change that undoes it, as JSON.
    pub inverse: String,
    /// BLAKE3 of the input line, if it had an id. It identifies a line that is sent twice.
    pub request: Option<[u8; 32]>,
    /// What the caller gave as evidence for the change, as JSON.
    pub evidence: Option<String>,
    /// BLAKE3 over the previous entry's hash and this entry.
    pub hash: [u8; 32],
}

impl LogEntry {
    /// This entry's hash, computed from the hash of the entry before.
    pub(super) fn hash_after(&self, before: &Hash) -> Hash {
        let request = self.request.as_ref().map_or(Field::Null, |hash| Field::Blob(hash));
        let fields = [
            Field::Integer(self.number as i64),
            Field::Real(self.time),
            Field::Text(&self.cause),
            self.id.as_deref().into(),
            self.undoes.map(|n| n as i64).into(),
            Field::Text(&self.change),
            Field::Text(&self.inverse),
            request,
            self.evidence.as_deref().into(),
        ];
        // Entries without evidence or a request are hashed as before these existed, so that older stores stay valid.
        let count = match (&self.evidence, &self.request) {
            (Some(_), _) => 9,
            (None, Some(_)) => 8,
            (None, None) => 7,
        };
        of_row(before, &fields[..count])
    }

    fn read(row: &Row<'_>) -> Result<Self> {
        let unsigned = |n: i64| u64::try_from(n).map_err(|_| damaged("a number is out of range"));
        Ok(Self {
            number: unsigned(get(row, 0)?)?,
            time: get(row, 1)?,
            cause: get(row, 2)?,
            id: get(row, 3)?,
            undoes: get::<Option<i64>>(row, 4)?.map(unsigned).transpose()?,
            change: get(row, 5)?,
            inverse: get(row, 6)?,
            request: get(row, 7)?,
            evidence: get(row, 9)?,
            hash: get(row, 8)?,
        })
    }
}

/// Visits all entries in order. Verifies that each follows the entry before, and that `meta` names the last one.
pub(super) fn walk(
    connection: &Connection,
    path: &Path,
    (meta, format): (&Meta, i32),
    mut visit: impl FnMut(LogEntry) -> Result<()>,
) -> Result<()> {
    let wrap = |e| refusal(path, "read the log", e);
    let evidence = if format < FORMAT { "NULL" } else { "evidence" };
    let columns = format!("number, time, cause, id, undoes, change, inverse, request, hash, {evidence}");
    let mut statement = connection.prepare(&format!("SELECT {columns} FROM log ORDER BY number")).map_err(wrap)?;
    let mut rows = statement.query([]).map_err(wrap)?;
    let (mut head, mut count) = (meta.first_head(), 0);
    while let Some(row) = rows.next().map_err(wrap)? {
        count += 1;
        let place = |e: Error| e.at(format!("log entry {count}"));
        let entry = LogEntry::read(row).map_err(place)?;
        if entry.number != count || entry.hash_after(&head) != entry.hash {
            return Err(place(damaged("it does not match its hash, or the entry before is missing")));
        }
        head = entry.hash;
        visit(entry).map_err(place)?;
    }
    if head != meta.head || count as i64 != meta.changes {
        let what = format!("the log ends after {count} of {} entries", meta.changes);
        return Err(damaged(what));
    }
    Ok(())
}

/// Returns the entries to undo, newest first, so that entry `number` can be undone.
///
/// A later entry conflicts if it touches a row that this entry wrote. A later entry that was undone, and the entry
/// that undid it, are ignored.
pub(super) fn undo_plan(entries: &[LogEntry], number: u64, cascade: bool) -> Result<Vec<u64>> {
    let at = |n: u64| entries.get((n as usize).wrapping_sub(1));
    let Some(wanted) = at(number) else {
        let what = format!("there is no change {number}; the log has {}", entries.len());
        return Err(Error::invalid(what, "presight env log lists the changes"));
    };
    let mut gone = BTreeSet::new();
    for entry in entries.iter().rev() {
        if let Some(undone) = entry.undoes.filter(|_| !gone.contains(&entry.number)) {
            if undone == number {
                let what = format!("change {number} was undone by change {}", entry.number);
                return Err(Error::invalid(what, format!("undo change {} to restore it", entry.number)));
            }
            // A pair is ignored only if both entries are later than `number`.
            if undone > number {
                gone.extend([entry.number, undone]);
            }
        }
    }
    // Keys that only the inverse reads do not count: they are needed to undo the entry, but give no reason to undo it.
    let touched = |entry: &LogEntry| -> Result<KeySets> {
        let (change, inverse): (Op, Op) = (from_json(&entry.change)?, from_json(&entry.inverse)?);
        Ok(KeySets { reads: KeySets::of(&[&change]).reads, ..KeySets::of(&[&change, &inverse]) })
    };
    let mut wrote = touched(wanted)?.writes;
    let (mut plan, mut in_the_way) = (vec![number], Vec::new());
    for entry in entries.iter().skip(number as usize).filter(|e| !gone.contains(&e.number)) {
        let theirs = touched(entry)?;
        let common = theirs.writes.iter().chain(&theirs.reads).find(|key| wrote.contains(key));
        if let Some(key) = common {
            in_the_way.push(format!("{} ({key})", entry.number));
            plan.push(entry.number);
            wrote.extend(theirs.writes);
        }
    }
    if !in_the_way.is_empty() && !cascade {
        const LISTED: usize = 10;
        let all = in_the_way.len();
        let more = if all > LISTED { format!(" and {} more", all - LISTED) } else { String::new() };
        in_the_way.truncate(LISTED);
        let what = format!("change {number} cannot be undone before changes {}{more}", in_the_way.join(", "));
        let remedy =
            format!("undo them first, or use `cascade: true` to undo all of them (appends {} changes)", all + 1);
        return Err(Error::invalid(what, remedy));
    }
    plan.reverse();
    Ok(plan)
}
