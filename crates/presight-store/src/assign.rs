//! Assigns the rows of a table to its columns, each to one of its own, with the least total cost (H. W. Kuhn 1955,
//! J. Munkres 1957). Costs are integers, so that a tie is exact.

/// Most steps for one table, rows times rows times columns: about a second.
pub(super) const MAX_WORK: usize = 1 << 28;

/// An optimal assignment.
#[derive(Debug, PartialEq)]
pub(super) struct Assignment {
    /// The column of each row.
    pub columns: Vec<usize>,
    /// True if another assignment has the same total.
    pub is_tie: bool,
}

/// The state of the search. Rows and columns count from 1; row 0 stands for none, and column 0 for the start of a path.
struct Search<'a> {
    costs: &'a [Vec<i64>],
    columns: usize,
    /// Prices of rows and columns: no pair costs less than their sum, and taken pairs cost exactly as much.
    of_rows: Vec<i64>,
    of_columns: Vec<i64>,
    /// The row of each column.
    taken_by: Vec<usize>,
}

/// Assigns every row of `costs` to a column of its own. There must be at least as many columns as rows.
pub(super) fn assign(costs: &[Vec<i64>]) -> Assignment {
    let (rows, columns) = (costs.len(), costs.first().map_or(0, Vec::len));
    let (of_rows, of_columns) = (vec![0; rows + 1], vec![0; columns + 1]);
    let mut search = Search { costs, columns, of_rows, of_columns, taken_by: vec![0; columns + 1] };
    (1..=rows).for_each(|row| search.add(row));
    let mut of_row = vec![0; rows];
    for (column, row) in search.taken_by.iter().enumerate().skip(1).filter(|(_, row)| **row != 0) {
        of_row[row - 1] = column - 1;
    }
    Assignment { is_tie: search.is_tie(&of_row), columns: of_row }
}

impl Search<'_> {
    /// What a pair costs above the prices of its row and column.
    fn above(&self, row: usize, column: usize) -> i64 {
        self.costs[row - 1][column - 1] - self.of_rows[row] - self.of_columns[column]
    }

    /// Assigns one more row, by the shortest path to a free column.
    fn add(&mut self, row: usize) {
        let size = self.columns + 1;
        let (mut least, mut from, mut done) = (vec![i64::MAX; size], vec![0; size], vec![false; size]);
        self.taken_by[0] = row;
        let mut column = 0;
        loop {
            done[column] = true;
            let (at, mut next, mut step) = (self.taken_by[column], 0, i64::MAX);
            for j in (1..size).filter(|j| !done[*j]) {
                let above = self.above(at, j);
                if above < least[j] {
                    (least[j], from[j]) = (above, column);
                }
                if least[j] < step {
                    (step, next) = (least[j], j);
                }
            }
            for (j, is_done) in done.iter().enumerate() {
                if *is_done {
                    self.of_rows[self.taken_by[j]] += step;
                    self.of_columns[j] -= step;
                } else if j > 0 {
                    least[j] -= step;
                }
            }
            column = next;
            if self.taken_by[column] == 0 {
                break;
            }
        }
        while column != 0 {
            self.taken_by[column] = self.taken_by[from[column]];
            column = from[column];
        }
    }

    /// True if rows can exchange columns in a ring, or by way of a free column, at no cost: then all pairs of the ring
    /// cost as much as their prices, and a column that becomes free has no price.
    fn is_tie(&self, of_row: &[usize]) -> bool {
        let free = of_row.len();
        // For each row, the rows whose columns it could take; the last node stands for the free columns.
        let mut next: Vec<Vec<usize>> = vec![Vec::new(); free + 1];
        for (row, own) in of_row.iter().enumerate() {
            for column in (0..self.columns).filter(|c| c != own && self.above(row + 1, c + 1) == 0) {
                next[row].push(self.taken_by[column + 1].checked_sub(1).unwrap_or(free));
            }
            if self.of_columns[own + 1] == 0 {
                next[free].push(row);
            }
        }
        // Nodes that nothing points to are removed until only rings, and what follows them, are left.
        let mut pointers = vec![0usize; free + 1];
        next.iter().flatten().for_each(|to| pointers[*to] += 1);
        let mut ends: Vec<usize> = (0..=free).filter(|node| pointers[*node] == 0).collect();
        let mut removed = 0;
        while let Some(node) = ends.pop() {
            removed += 1;
            for to in &next[node] {
                pointers[*to] -= 1;
                if pointers[*to] == 0 {
                    ends.push(*to);
                }
            }
        }
        removed <= free
    }
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
            let (least, ways) = by_force(&costs, 0, &mut vec![false; columns]);
            let total: i64 = found.columns.iter().zip(&costs).map(|(c, row)| row[*c]).sum();
            prop_assert_eq!((total, found.is_tie), (least, ways > 1));
            let mut own = found.columns;
            own.sort_unstable();
            own.dedup();
            prop_assert_eq!(own.len(), rows);
        }
    }
}
