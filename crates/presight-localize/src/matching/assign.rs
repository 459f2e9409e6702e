//! The assignment with the lowest total cost.

use pathfinding::prelude::{Matrix, kuhn_munkres};
use presight_model::error::{Error, Result};
use presight_model::union_find::UnionFind;

/// Maximum work for one group: rows squared times columns, about 50 ms. Larger groups are matched greedily and counted.
pub const MAX_GROUP_WORK: usize = 1 << 24;

/// The algorithm needs integer costs; this is the number of steps per unit.
const STEPS: f64 = (1u64 << 20) as f64;

/// Maximum gain of one pair. Sums over a million rows cannot overflow.
const MAX_GAIN: f64 = 1e6;

/// A possible pair of an expected feature and a detection.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CandidatePair {
    /// The expected feature.
    pub row: u32,
    /// The detection.
    pub column: u32,
    /// Negative log-likelihood ratio.
    pub cost: f64,
}

/// Result of the assignment.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Assignment {
    /// Column assigned to each row; `None` if it has no detection.
    pub columns: Vec<Option<u32>>,
    /// Index of the candidate assigned to each row.
    pub candidates: Vec<Option<u32>>,
    /// Sum of the costs of the pairs and of the rows without a column.
    pub cost: f64,
    /// Number of connected groups of rows and columns; each is solved separately.
    pub groups: usize,
    /// Number of groups beyond [`MAX_GROUP_WORK`]. They are matched greedily and may cost more than the optimum.
    pub greedy_groups: usize,
}

/// Assigns to each row one column or none so that the total cost is lowest. No column is used twice. `unseen[row]` is
/// the cost of a row without a column. A pair that costs more than that is never taken. Each connected group of
/// candidates is solved separately by the algorithm of Kuhn and Munkres on costs rounded to a millionth. If costs are
/// equal, a group with one row takes the lowest column, and a group with one column the lowest row.
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`] for a candidate whose row is not in `unseen`, and for costs that are not
/// finite.
pub fn assign(candidates: &[CandidatePair], unseen: &[f64]) -> Result<Assignment> {
    check(candidates, unseen)?;
    let mut found =
        Assignment { columns: vec![None; unseen.len()], candidates: vec![None; unseen.len()], ..Assignment::default() };
    let mut edges: Vec<Saving> = Vec::with_capacity(candidates.len());
    for (i, c) in candidates.iter().enumerate() {
        let gain = unseen[c.row as usize] - c.cost;
        if gain > 0.0 {
            edges.push(Saving {
                group: 0,
                row: c.row,
                column: c.column,
                gain: gain.min(MAX_GAIN),
                candidate: i as u32,
            });
        }
    }
    name_groups(&mut edges, unseen.len());
    edges.sort_unstable_by_key(|e| (e.group, e.row, e.column, e.candidate));
    // The best of repeated pairs counts.
    edges.dedup_by(|next, kept| {
        let repeats = (next.row, next.column) == (kept.row, kept.column);
        if repeats && next.gain > kept.gain {
            *kept = *next;
        }
        repeats
    });
    for group in edges.chunk_by(|a, b| a.group == b.group) {
        found.groups += 1;
        solve(group, &mut found);
    }
    found.cost = total(candidates, unseen, &found.candidates);
    Ok(found)
}

fn check(candidates: &[CandidatePair], unseen: &[f64]) -> Result<()> {
    if let Some(i) = unseen.iter().position(|x| !x.is_finite()) {
        let what = format!("the cost of leaving row {i} unmatched is {}", unseen[i]);
        return Err(Error::invalid(what, "give a finite number"));
    }
    for (i, c) in candidates.iter().enumerate() {
        if c.row as usize >= unseen.len() {
            let what = format!("candidate {i} names row {} of {}", c.row, unseen.len());
            return Err(Error::invalid(what, "give every row its cost of being unmatched"));
        }
        if !c.cost.is_finite() {
            return Err(Error::invalid(format!("candidate {i} costs {}", c.cost), "give a finite number"));
        }
    }
    Ok(())
}

fn total(candidates: &[CandidatePair], unseen: &[f64], taken: &[Option<u32>]) -> f64 {
    let of = |(row, taken): (usize, &Option<u32>)| taken.map_or(unseen[row], |i| candidates[i as usize].cost);
    taken.iter().enumerate().map(of).sum()
}

/// A pair that costs less than leaving its row unmatched.
#[derive(Clone, Copy, Debug)]
struct Saving {
    group: u32,
    row: u32,
    column: u32,
    /// Cost saved by the pair.
    gain: f64,
    candidate: u32,
}

/// Labels each edge with the lowest row of its connected group.
fn name_groups(edges: &mut [Saving], rows: usize) {
    let mut groups = UnionFind::new(rows);
    let mut by_column: Vec<u32> = (0..edges.len() as u32).collect();
    by_column.sort_unstable_by_key(|i| edges[*i as usize].column);
    for pair in by_column.windows(2) {
        let [a, b] = [edges[pair[0] as usize], edges[pair[1] as usize]];
        if a.column == b.column {
            groups.join(a.row, b.row);
        }
    }
    for edge in edges {
        edge.group = groups.root(edge.row);
    }
}

/// Solves one group, whose edges are sorted by row.
fn solve(edges: &[Saving], found: &mut Assignment) {
    let (first, last) = (edges[0], edges[edges.len() - 1]);
    let best = |a: Saving, b: Saving| if b.gain > a.gain { b } else { a };
    if first.row == last.row || edges.iter().all(|e| e.column == first.column) {
        take(edges.iter().copied().fold(first, best), found);
        return;
    }
    let rows = edges.chunk_by(|a, b| a.row == b.row).count();
    // An optimum never needs more than a row's best `rows` columns, because the other rows cannot use all of them.
    let mut kept: Vec<Saving> = Vec::with_capacity(edges.len());
    for row in edges.chunk_by(|a, b| a.row == b.row) {
        let start = kept.len();
        kept.extend_from_slice(row);
        kept[start..].sort_unstable_by(|a, b| b.gain.total_cmp(&a.gain).then(a.column.cmp(&b.column)));
        kept.truncate(start + rows);
    }
    let mut columns: Vec<u32> = kept.iter().map(|e| e.column).collect();
    columns.sort_unstable();
    columns.dedup();
    if rows.saturating_mul(rows).saturating_mul(columns.len().max(rows)) > MAX_GROUP_WORK {
        found.greedy_groups += 1;
        solve_greedily(kept, found);
    } else {
        solve_optimally(&kept, rows, &columns, found);
    }
}

/// Pairs that are not candidates have a gain of 0. A row assigned to such a pair stays unmatched.
fn solve_optimally(edges: &[Saving], rows: usize, columns: &[u32], found: &mut Assignment) {
    let mut gains = Matrix::new(rows, columns.len().max(rows), 0i64);
    let mut of: Vec<(usize, usize, Saving)> = Vec::with_capacity(edges.len());
    for (r, row) in edges.chunk_by(|a, b| a.row == b.row).enumerate() {
        for edge in row {
            let c = columns.partition_point(|c| *c < edge.column);
            gains[(r, c)] = (edge.gain * STEPS).round() as i64;
            of.push((r, c, *edge));
        }
    }
    let (_, taken) = kuhn_munkres(&gains);
    for (r, c, edge) in of {
        if taken[r] == c && gains[(r, c)] > 0 {
            take(edge, found);
        }
    }
}

fn solve_greedily(mut edges: Vec<Saving>, found: &mut Assignment) {
    edges.sort_unstable_by(|a, b| b.gain.total_cmp(&a.gain).then((a.row, a.column).cmp(&(b.row, b.column))));
    let mut columns = std::collections::BTreeSet::new();
    for edge in edges {
        if found.columns[edge.row as usize].is_none() && columns.insert(edge.column) {
            take(edge, found);
        }
    }
}

fn take(edge: Saving, found: &mut Assignment) {
    found.columns[edge.row as usize] = Some(edge.column);
    found.candidates[edge.row as usize] = Some(edge.candidate);
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The lowest cost by exhaustive search.
    fn by_force(costs: &[Vec<Option<f64>>], unseen: &[f64], row: usize, taken: &mut Vec<bool>) -> f64 {
        if row == unseen.len() {
            return 0.0;
        }
        let mut best = unseen[row] + by_force(costs, unseen, row + 1, taken);
        for column in 0..taken.len() {
            if let Some(cost) = costs[row][column]
                && !taken[column]
            {
                taken[column] = true;
                best = best.min(cost + by_force(costs, unseen, row + 1, taken));
                taken[column] = false;
            }
        }
        best
    }

    fn candidates(costs: &[Vec<Option<f64>>]) -> Vec<CandidatePair> {
        let mut all = Vec::new();
        for (row, line) in costs.iter().enumerate() {
            for (column, cost) in line.iter().enumerate() {
                if let Some(cost) = *cost {
                    all.push(CandidatePair { row: row as u32, column: column as u32, cost });
                }
            }
        }
        all
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]
        #[test]
        fn assignments_cost_what_trying_everything_finds(
            costs in (1..=6usize).prop_flat_map(|columns| {
                let cell = prop_oneof![2 => Just(None), 3 => (-8.0..8.0f64).prop_map(Some)];
                prop::collection::vec(prop::collection::vec(cell, columns), 1..=6)
            }),
            unseen in prop::collection::vec(-4.0..6.0f64, 6),
        ) {
            let unseen = &unseen[..costs.len()];
            let found = assign(&candidates(&costs), unseen).unwrap();
            let expected = by_force(&costs, unseen, 0, &mut vec![false; costs[0].len()]);
            // Costs are rounded to a millionth for the algorithm.
            prop_assert!((found.cost - expected).abs() < 1e-5, "{} and {expected}", found.cost);
            let mut columns: Vec<u32> = found.columns.iter().flatten().copied().collect();
            let taken = columns.len();
            columns.sort_unstable();
            columns.dedup();
            prop_assert_eq!(columns.len(), taken, "a column was given twice");
            for (row, column) in found.columns.iter().enumerate() {
                prop_assert!(column.is_none_or(|c| costs[row][c as usize].is_some()));
            }
        }
    }

    #[test]
    fn what_costs_more_than_not_being_seen_is_not_seen() {
        let dear = [CandidatePair { row: 0, column: 0, cost: 3.0 }];
        assert_eq!(assign(&dear, &[2.9]).unwrap().columns, [None]);
        assert_eq!(assign(&dear, &[3.1]).unwrap().columns, [Some(0)]);
        let nothing = assign(&[], &[1.0, 2.0]).unwrap();
        assert_eq!((nothing.columns, nothing.cost, nothing.groups), (vec![None, None], 3.0, 0));
    }

    #[test]
    fn groups_are_apart() {
        let pair = |row, column, cost| CandidatePair { row, column, cost };
        let pairs = [pair(0, 0, 0.0), pair(1, 0, 1.0), pair(2, 5, 0.0), pair(3, 6, 0.0), pair(3, 7, -1.0)];
        let found = assign(&pairs, &[4.0; 5]).unwrap();
        assert_eq!(found.columns, [Some(0), None, Some(5), Some(7), None]);
        assert_eq!((found.groups, found.greedy_groups), (3, 0));
    }

    /// Row 0 gives one pair twice; its other pair must still count, because row 1 needs the repeated column.
    #[test]
    fn a_repeated_pair_takes_no_other_pairs_place() {
        let pair = |row, column, cost| CandidatePair { row, column, cost };
        let pairs = [pair(0, 0, 1.1), pair(0, 0, 1.0), pair(0, 1, 5.0), pair(1, 0, 1.0)];
        let found = assign(&pairs, &[10.0; 2]).unwrap();
        assert_eq!((found.columns, found.cost), (vec![Some(1), Some(0)], 6.0));
        assert_eq!(assign(&pairs[..3], &[10.0]).unwrap().candidates, [Some(1)]);
    }

    #[test]
    fn bad_costs_are_errors() {
        let pair = |row, cost| [CandidatePair { row, column: 0, cost }];
        for (pairs, unseen) in [
            (pair(0, f64::NAN), vec![1.0]),
            (pair(0, f64::INFINITY), vec![1.0]),
            (pair(1, 0.0), vec![1.0]),
            (pair(0, 0.0), vec![f64::NAN]),
        ] {
            assert_eq!(assign(&pairs, &unseen).unwrap_err().kind(), presight_model::ErrorKind::Invalid);
        }
    }

    /// 2,000 rows compete for the same 2,000 columns. The optimum takes too long, so the result is greedy.
    #[test]
    fn a_group_too_large_is_matched_greedily_and_counted() {
        let side = 2000u32;
        let pairs: Vec<CandidatePair> = (0..side)
            .flat_map(|row| {
                (0..20).map(move |k| CandidatePair { row, column: (row + 97 * k) % side, cost: f64::from(k) })
            })
            .collect();
        let found = assign(&pairs, &vec![50.0; side as usize]).unwrap();
        assert_eq!((found.groups, found.greedy_groups), (1, 1));
        assert!(found.columns.iter().enumerate().all(|(row, column)| *column == Some(row as u32)));
    }
}
