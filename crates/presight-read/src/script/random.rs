//! Random numbers for scripts.

use presight_model::random::SplitMix64;
use std::cell::Cell;
use std::rc::Rc;

/// Copies share one sequence, so that a function can draw from its caller's generator.
#[derive(Clone, Debug)]
pub(super) struct Random(Rc<Cell<SplitMix64>>);

impl Random {
    pub fn new(seed: i64) -> Self {
        Self(Rc::new(Cell::new(SplitMix64(seed as u64))))
    }

    fn draw<T>(&self, one: impl FnOnce(&mut SplitMix64) -> T) -> T {
        let mut numbers = self.0.get();
        let drawn = one(&mut numbers);
        self.0.set(numbers);
        drawn
    }

    /// The next number in 0..1.
    pub fn unit(&self) -> f64 {
        self.draw(SplitMix64::unit)
    }

    /// The next whole number in 0..n, for `n` up to 2^64; within 2^-64 n of uniform.
    pub fn below(&self, n: u128) -> u64 {
        ((u128::from(self.draw(SplitMix64::bits)) * n) >> 64) as u64
    }
}
