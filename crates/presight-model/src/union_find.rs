//! Disjoint sets.

/// A partition of the numbers `0..count` into disjoint sets (union-find with path halving: Tarjan and van Leeuwen
/// 1984). The root of a set stands for it.
///
/// ```
/// use presight_model::union_find::UnionFind;
/// let mut sets = UnionFind::new(5);
/// sets.join(4, 2);
/// sets.join(2, 3);
/// assert_eq!((sets.root(4), sets.root(1)), (2, 1));
/// assert_eq!(sets.into_roots(), [0, 1, 2, 2, 2]);
/// ```
#[derive(Clone, Debug)]
pub struct UnionFind {
    parents: Vec<u32>,
}

impl UnionFind {
    /// A set for each number. `count` is at most 2^32.
    pub fn new(count: usize) -> Self {
        Self { parents: (0..count as u32).collect() }
    }

    /// The root of the set that holds `number`.
    pub fn root(&mut self, mut number: u32) -> u32 {
        while !self.is_root(number) {
            let grandparent = self.parents[self.parents[number as usize] as usize];
            self.parents[number as usize] = grandparent;
            number = grandparent;
        }
        number
    }

    /// True if `number` is the root of its set.
    pub fn is_root(&self, number: u32) -> bool {
        self.parents[number as usize] == number
    }

    /// Joins the sets of two numbers. The root is the lower one of their roots; while sets are joined by this method
    /// alone, it is the lowest number of its set.
    pub fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.root(a), self.root(b));
        self.parents[a.max(b) as usize] = a.min(b);
    }

    /// Joins the set of `other` to that of `kept`, whose root remains.
    pub fn join_to(&mut self, kept: u32, other: u32) {
        let (kept, other) = (self.root(kept), self.root(other));
        self.parents[other as usize] = kept;
    }

    /// The root of the set of each number.
    pub fn into_roots(mut self) -> Vec<u32> {
        (0..self.parents.len() as u32).map(|number| self.root(number)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::SplitMix64;

    /// Random joins, against labels that are all rewritten at each join.
    #[test]
    fn sets_agree_with_labels() {
        let mut random = SplitMix64(3);
        let mut draw = || (random.uniform(0.0, 50.0) as u32).min(49);
        let (mut lowest, mut kept) = (UnionFind::new(50), UnionFind::new(50));
        let [mut low_labels, mut kept_labels]: [Vec<u32>; 2] = std::array::from_fn(|_| (0..50).collect());
        for _ in 0..40 {
            let (a, b) = (draw(), draw());
            lowest.join(a, b);
            let (p, q) = (low_labels[a as usize], low_labels[b as usize]);
            low_labels.iter_mut().filter(|l| **l == p || **l == q).for_each(|l| *l = p.min(q));
            kept.join_to(a, b);
            let (p, q) = (kept_labels[a as usize], kept_labels[b as usize]);
            kept_labels.iter_mut().filter(|l| **l == q).for_each(|l| *l = p);
        }
        assert!((0..50).all(|i| lowest.is_root(i) == (low_labels[i as usize] == i)));
        assert_eq!(lowest.into_roots(), low_labels);
        assert_eq!(kept.into_roots(), kept_labels);
    }
}
