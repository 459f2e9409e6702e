//! Detections that another feature explains nearly as well.

use super::assign::{Assignment, CandidatePair};

/// Takes back the pairs of an assignment in which another feature explains the detection with more than the probability
/// `1 - confidence`. `pairs` are sorted by row, and a row without a column costs `unseen`. The alternatives are that the
/// other feature takes the detection, while the first takes the other's, a free one, or none. Returns the rows.
pub(crate) fn withhold_doubtful(
    pairs: &[CandidatePair],
    unseen: f64,
    confidence: f64,
    assignment: &mut Assignment,
) -> Vec<usize> {
    let columns = pairs.iter().map(|p| p.column as usize + 1).max().unwrap_or(0);
    let mut owners: Vec<Vec<u32>> = Vec::new();
    let mut shared: Vec<Option<u32>> = vec![None; columns];
    let mut first: Vec<Option<u32>> = vec![None; columns];
    for (i, pair) in pairs.iter().enumerate() {
        let column = pair.column as usize;
        match (first[column], shared[column]) {
            (None, _) => first[column] = Some(i as u32),
            (Some(before), None) => {
                shared[column] = Some(owners.len() as u32);
                owners.push(vec![before, i as u32]);
            }
            (Some(_), Some(list)) => owners[list as usize].push(i as u32),
        }
    }
    if owners.is_empty() {
        return Vec::new();
    }
    let mut is_taken = vec![false; columns];
    assignment.columns.iter().flatten().for_each(|c| is_taken[*c as usize] = true);
    let now = |row: u32| assignment.candidates[row as usize].map_or(unseen, |i| pairs[i as usize].cost);
    let mut doubtful = Vec::new();
    // Cost of each column for the row at hand.
    let mut costs = vec![f64::INFINITY; columns];
    for own in pairs.chunk_by(|a, b| a.row == b.row) {
        let row = own[0].row;
        let Some(column) = assignment.columns[row as usize] else { continue };
        let Some(list) = shared[column as usize] else { continue };
        own.iter().for_each(|p| costs[p.column as usize] = p.cost);
        let free = own.iter().filter(|p| !is_taken[p.column as usize]);
        let alone = (-unseen).exp() + free.map(|p| (-p.cost).exp()).sum::<f64>();
        let odds = |rival: &CandidatePair| {
            let swapped = assignment.columns[rival.row as usize].map_or(0.0, |c| (-costs[c as usize]).exp());
            (now(row) + now(rival.row) - rival.cost).exp() * (alone + swapped)
        };
        let rivals = owners[list as usize].iter().map(|i| &pairs[*i as usize]).filter(|p| p.row != row);
        if rivals.map(odds).sum::<f64>() * confidence > 1.0 - confidence {
            doubtful.push(row as usize);
        }
        own.iter().for_each(|p| costs[p.column as usize] = f64::INFINITY);
    }
    for row in &doubtful {
        (assignment.columns[*row], assignment.candidates[*row]) = (None, None);
    }
    doubtful
}

#[cfg(test)]
mod tests {
    use super::super::assign;
    use super::*;

    fn left(costs: &[(u32, u32, f64)]) -> Vec<Option<u32>> {
        let pairs: Vec<CandidatePair> =
            costs.iter().map(|(row, column, cost)| CandidatePair { row: *row, column: *column, cost: *cost }).collect();
        let mut assignment = assign(&pairs, &[2.0; 2]).unwrap();
        withhold_doubtful(&pairs, 2.0, 0.99, &mut assignment);
        assignment.columns
    }

    #[test]
    fn a_pair_is_withheld_if_a_rival_has_more_than_a_hundredth() {
        // One detection, and the odds of the rival are exp(-d): 0.0101 at d = 4.595.
        assert_eq!(left(&[(0, 0, -5.0), (1, 0, -0.41)]), [None, None]);
        assert_eq!(left(&[(0, 0, -5.0), (1, 0, -0.40)]), [Some(0), None]);
        // Each has its own: only the swap is left, exp(-2 d), and the odds that one is missed and one is clutter.
        assert_eq!(left(&[(0, 0, -5.0), (0, 1, -4.0), (1, 0, -4.0), (1, 1, -5.0)]), [None, None]);
        assert_eq!(left(&[(0, 0, -5.0), (0, 1, -2.0), (1, 0, -2.0), (1, 1, -5.0)]), [Some(0), Some(1)]);
    }
}
