//! Eight lanes of f32 in as many registers as the processor needs. Each value carries the token of its instruction set,
//! and all functions are inlined into the task that is compiled for that set.

use pulp::Simd;
use std::ops::{Add, Mul, Sub};

/// An instruction set, with operations that `pulp::Simd` lacks.
pub(super) trait Width: Simd {
    /// True if a product and a sum are one instruction; without it they would be a call into the C library.
    const FUSED: bool;

    /// A bit for each lane of a register.
    fn bits(self, mask: Self::m32s) -> u32;

    /// Prefetches some lines of memory.
    #[inline(always)]
    fn fetch<T>(self, _: &T, _lines: usize) {}
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use super::Width;
    use pulp::x86::{V2, V3};

    const LINE: usize = 64;

    impl Width for V3 {
        const FUSED: bool = true;

        #[inline(always)]
        fn bits(self, mask: Self::m32s) -> u32 {
            self.avx._mm256_movemask_ps(bytemuck::cast(mask)) as u32
        }

        #[inline(always)]
        fn fetch<T>(self, at: &T, lines: usize) {
            let first = (&raw const *at).cast::<i8>();
            for i in 0..lines {
                self.sse._mm_prefetch::<3>(first.wrapping_add(LINE * i));
            }
        }
    }

    impl Width for V2 {
        const FUSED: bool = false;

        #[inline(always)]
        fn bits(self, mask: Self::m32s) -> u32 {
            self.sse._mm_movemask_ps(bytemuck::cast(mask)) as u32
        }

        #[inline(always)]
        fn fetch<T>(self, at: &T, lines: usize) {
            let first = (&raw const *at).cast::<i8>();
            for i in 0..lines {
                self.sse._mm_prefetch::<3>(first.wrapping_add(LINE * i));
            }
        }
    }
}

impl Width for pulp::Scalar {
    const FUSED: bool = false;

    #[inline(always)]
    fn bits(self, mask: bool) -> u32 {
        u32::from(mask)
    }
}

/// Eight numbers in `N` registers.
#[derive(Clone, Copy)]
pub(super) struct Eight<S: Width, const N: usize>([S::f32s; N], S);

/// A truth value for each lane.
#[derive(Clone, Copy)]
pub(super) struct Mask<S: Width, const N: usize>([S::m32s; N], S);

/// Three coordinates.
pub(super) type Three<S, const N: usize> = [Eight<S, N>; 3];

/// Written out: `map` and iterators of vectors are not inlined.
macro_rules! three {
    ($i:ident => $e:expr) => {
        [
            {
                let $i = 0;
                $e
            },
            {
                let $i = 1;
                $e
            },
            {
                let $i = 2;
                $e
            },
        ]
    };
}
pub(super) use three;

/// Written out, as closures are not inlined either.
macro_rules! lanewise {
    ($name:ident, $op:ident) => {
        #[inline(always)]
        pub fn $name(self, b: Self) -> Self {
            let mut all = self.0;
            for i in 0..N {
                all[i] = self.1.$op(self.0[i], b.0[i]);
            }
            Self(all, self.1)
        }
    };
}

macro_rules! operator {
    ($trait:ident, $name:ident, $op:ident) => {
        impl<S: Width, const N: usize> $trait for Eight<S, N> {
            type Output = Self;

            #[inline(always)]
            fn $name(self, b: Self) -> Self {
                let mut all = self.0;
                for i in 0..N {
                    all[i] = self.1.$op(self.0[i], b.0[i]);
                }
                Self(all, self.1)
            }
        }
    };
}

/// Makes eights.
#[derive(Clone, Copy)]
pub(super) struct Make<S: Width, const N: usize>(pub S);

impl<S: Width, const N: usize> Make<S, N> {
    #[inline(always)]
    pub fn splat(self, x: f32) -> Eight<S, N> {
        Eight([self.0.splat_f32s(x); N], self.0)
    }

    #[inline(always)]
    pub fn three(self, x: &[f32; 3]) -> Three<S, N> {
        [self.splat(x[0]), self.splat(x[1]), self.splat(x[2])]
    }

    #[inline(always)]
    #[expect(clippy::manual_memcpy, reason = "a call would cost more than these few registers")]
    pub fn load(self, x: &[f32; 8]) -> Eight<S, N> {
        let (parts, _) = S::as_simd_f32s(x);
        let mut all = [parts[0]; N];
        for i in 1..N {
            all[i] = parts[i];
        }
        Eight(all, self.0)
    }

    #[inline(always)]
    pub fn load_three(self, x: &[[f32; 8]; 3]) -> Three<S, N> {
        [self.load(&x[0]), self.load(&x[1]), self.load(&x[2])]
    }
}

impl<S: Width, const N: usize> Eight<S, N> {
    #[inline(always)]
    #[expect(clippy::manual_memcpy, reason = "a call would cost more than these few registers")]
    pub fn store(self, to: &mut [f32; 8]) {
        let (parts, _) = S::as_mut_simd_f32s(to);
        for i in 0..N {
            parts[i] = self.0[i];
        }
    }

    /// `self b + c`, rounded once or twice.
    #[inline(always)]
    pub fn times_plus(self, b: Self, c: Self) -> Self {
        let mut all = self.0;
        for i in 0..N {
            all[i] = match S::FUSED {
                true => self.1.mul_add_f32s(self.0[i], b.0[i], c.0[i]),
                false => self.1.add_f32s(self.1.mul_f32s(self.0[i], b.0[i]), c.0[i]),
            };
        }
        Self(all, self.1)
    }

    /// `self b - c`, rounded once or twice.
    #[inline(always)]
    pub fn times_minus(self, b: Self, c: Self) -> Self {
        let mut all = self.0;
        for i in 0..N {
            all[i] = match S::FUSED {
                true => self.1.mul_add_f32s(self.0[i], b.0[i], self.1.xor_f32s(c.0[i], self.1.splat_f32s(-0.0))),
                false => self.1.sub_f32s(self.1.mul_f32s(self.0[i], b.0[i]), c.0[i]),
            };
        }
        Self(all, self.1)
    }

    lanewise!(over, div_f32s);
    lanewise!(max, max_f32s);
    lanewise!(min, min_f32s);
    // Flips the sign of lanes whose sign bit is set in the argument.
    lanewise!(flipped, xor_f32s);

    #[inline(always)]
    pub fn abs(self) -> Self {
        let mut all = self.0;
        for i in 0..N {
            // `abs_f32s` is not inlined.
            all[i] = self.1.and_f32s(self.0[i], self.1.splat_f32s(f32::from_bits(0x7fff_ffff)));
        }
        Self(all, self.1)
    }

    /// Its sign bits.
    #[inline(always)]
    pub fn sign(self) -> Self {
        let mut all = self.0;
        for i in 0..N {
            all[i] = self.1.and_f32s(self.0[i], self.1.splat_f32s(-0.0));
        }
        Self(all, self.1)
    }

    #[inline(always)]
    pub fn at_least(self, b: Self) -> Mask<S, N> {
        let mut all = [self.1.greater_than_or_equal_f32s(self.0[0], b.0[0]); N];
        for i in 1..N {
            all[i] = self.1.greater_than_or_equal_f32s(self.0[i], b.0[i]);
        }
        Mask(all, self.1)
    }

    #[inline(always)]
    pub fn more_than(self, b: Self) -> Mask<S, N> {
        let mut all = [self.1.greater_than_f32s(self.0[0], b.0[0]); N];
        for i in 1..N {
            all[i] = self.1.greater_than_f32s(self.0[i], b.0[i]);
        }
        Mask(all, self.1)
    }

    /// The minimum of its lanes, which must not be NaN.
    #[inline(always)]
    pub fn least(self) -> f32 {
        let mut all = [0.0; 8];
        self.store(&mut all);
        let mut least = all[0];
        for x in &all[1..] {
            least = if *x < least { *x } else { least };
        }
        least
    }
}

impl<S: Width, const N: usize> Mask<S, N> {
    /// A bit for each lane.
    #[inline(always)]
    pub fn bits(self) -> u32 {
        let mut all = 0;
        for i in 0..N {
            all |= self.1.bits(self.0[i]) << (8 / N * i);
        }
        all
    }

    #[inline(always)]
    pub fn and(self, b: Self) -> Self {
        let mut all = self.0;
        for i in 0..N {
            all[i] = self.1.and_m32s(self.0[i], b.0[i]);
        }
        Self(all, self.1)
    }

    #[inline(always)]
    pub fn select(self, yes: Eight<S, N>, no: Eight<S, N>) -> Eight<S, N> {
        let mut all = no.0;
        for i in 0..N {
            all[i] = self.1.select_f32s(self.0[i], yes.0[i], no.0[i]);
        }
        Eight(all, self.1)
    }

    /// Writes a number to the lanes that are set.
    #[inline(always)]
    pub fn put(self, number: u32, to: &mut [u32; 8]) {
        let (parts, _) = S::as_mut_simd_u32s(to);
        for i in 0..N {
            parts[i] = self.1.select_u32s(self.0[i], self.1.splat_u32s(number), parts[i]);
        }
    }
}

operator!(Add, add, add_f32s);

operator!(Sub, sub, sub_f32s);

operator!(Mul, mul, mul_f32s);

/// `a . b`.
#[inline(always)]
pub(super) fn dot<S: Width, const N: usize>(a: &Three<S, N>, b: &Three<S, N>) -> Eight<S, N> {
    a[0].times_plus(b[0], a[1].times_plus(b[1], a[2] * b[2]))
}

#[inline(always)]
pub(super) fn cross<S: Width, const N: usize>(a: &Three<S, N>, b: &Three<S, N>) -> Three<S, N> {
    [a[1].times_minus(b[2], a[2] * b[1]), a[2].times_minus(b[0], a[0] * b[2]), a[0].times_minus(b[1], a[1] * b[0])]
}

/// Sum of the absolute coordinates.
#[inline(always)]
pub(super) fn size<S: Width, const N: usize>(a: &Three<S, N>) -> Eight<S, N> {
    a[0].abs() + a[1].abs() + a[2].abs()
}
