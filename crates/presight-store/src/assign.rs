//! Assigns each row of a table to a different column with minimum total cost. Costs are integers,
//! so that a tie is exact.

use pathfinding::prelude::{Matrix, kuhn_munkres_min};

/// Maximum number of steps for one table, rows times rows times columns: about a second.
pub(super) const MAX_WORK: usize = 1 << 27;

/// An optimal assignment.
#[derive(Debug, PartialEq)]
pub(super) struct Assignment {
    /// The column of each row.
    pub columns: Vec<usize>,
    /// True if another assignment has the same total.
    pub is_tie: bool,
}

/// Assigns every row of `costs` to a different column. There must be at least as many columns as rows.
pub(super) fn assign(costs: &[Vec<i64>]) -> Assignment {
    // In steps of more than the number of rows a cost of one for each pair only decides between equal totals.
    let step = costs.len() as i64 + 1;
    let best = |cost: &dyn Fn(usize, usize) -> i64| {
        let table = Matrix::from_fn(costs.len(), costs[0].len(), |(row, column)| cost(row, column));
        kuhn_munkres_min(&table).1
    };
    if costs.is_empty() {
        return Assignment { columns: Vec::new(), is_tie: false };
    }
    let columns = best(&|row, column| costs[row][column]);
    let other = best(&|row, column| step * costs[row][column] + i64::from(columns[row] == column));
    let total = |columns: &[usize]| columns.iter().zip(costs).map(|(column, row)| row[*column]).sum::<i64>();
    Assignment { is_tie: other != columns && total(&other) == total(&columns), columns }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The least total of the rows from `row` on, and the number of assignments that have it.
    fn by_force(costs: &[Vec<i64>], row: usize, taken: &mut [bool]) -> (i64, usize) {
        if row == costs.len() {
            return (0, 1);
        }
        let mut best = (i64::MAX, 0);
        for column in 0..taken.len() {
            if std::mem::replace(&mut taken[column], true) {
                continue;
            }
            let (rest, ways) = by_force(costs, row + 1, taken);
            taken[column] = false;
            let total = costs[row][column] + rest;
            match total.cmp(&best.0) {
                std::cmp::Ordering::Less => best = (total, ways),
                std::cmp::Ordering::Equal => best.1 += ways,
                std::cmp::Ordering::Greater => {}
            }
        }
        best
    }

    proptest! {
        #[test]
        fn totals_and_ties_are_those_of_trying_everything(
            rows in 1usize..5,
            more in 0usize..3,
            numbers in proptest::collection::vec(0i64..12, 40),
        ) {
            let columns = rows + more;
            let costs: Vec<Vec<i64>> = numbers.chunks(columns).take(rows).map(<[i64]>::to_vec).collect();
            let found = assign(&costs);
            let (min_total, assignments) = by_force(&costs, 0, &mut vec![false; columns]);
            let total: i64 = found.columns.iter().zip(&costs).map(|(c, row)| row[*c]).sum();
            prop_assert_eq!((total, found.is_tie), (min_total, assignments > 1));
            let mut own = found.columns;
            own.sort_unstable();
            own.dedup();
            prop_assert_eq!(own.len(), rows);
        }
    }
}
