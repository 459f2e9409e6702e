//! What all rasterizers do with a depth: the nearest wins.

use super::raster_lines::EIGHT;
use pulp::Simd;

/// Merges one polygon's depths into octets of the buffer.
pub(super) struct Nearest<S: Simd> {
    number: S::u64s,
    nowhere: S::f64s,
    none: S::u64s,
    all: S::u64s,
    /// Lanes in which the buffer held the same depth.
    ties: S::u64s,
    /// Lanes in which the polygon was nearer.
    written: S::u64s,
}

impl<S: Simd> Nearest<S> {
    #[inline(always)]
    pub fn new(simd: S, number: u32) -> Self {
        let (none, all) = (simd.splat_u64s(0), simd.splat_u64s(u64::MAX));
        let (number, nowhere) = (simd.splat_u64s(number.into()), simd.splat_f64s(-1.0));
        Self { number, nowhere, none, all, ties: none, written: none }
    }

    /// Takes inverse depths where they are inside and nearer than what the buffer holds.
    #[inline(always)]
    pub fn merge(&mut self, simd: S, k: S::f64s, inside: S::m64s, (inverse, winner): (&mut S::f64s, &mut S::u64s)) {
        let k = simd.select_f64s(inside, k, self.nowhere);
        let before = *inverse;
        let nearer = simd.select_u64s(simd.greater_than_f64s(k, before), self.all, self.none);
        self.ties = simd.select_u64s(simd.equal_f64s(k, before), self.all, self.ties);
        self.written = simd.or_u64s(self.written, nearer);
        // A maximum, for a select before a store becomes a masked store (as that of the winners, written as it may be).
        *inverse = simd.max_f64s(k, before);
        *winner = simd.xor_u64s(*winner, simd.and_u64s(simd.xor_u64s(*winner, self.number), nearer));
    }

    /// True if anywhere the buffer held the same depth.
    #[inline(always)]
    pub fn has_ties(&self) -> bool {
        any_of::<S>(self.ties)
    }

    /// True if anywhere the polygon was nearer.
    #[inline(always)]
    pub fn has_written(&self) -> bool {
        any_of::<S>(self.written)
    }
}

/// True if any lane is not zero.
#[inline(always)]
fn any_of<S: Simd>(lanes: S::u64s) -> bool {
    let mut all = [0; EIGHT];
    S::as_mut_simd_u64s(&mut all).0[0] = lanes;
    all.iter().fold(0, |any, lane| any | lane) != 0
}
