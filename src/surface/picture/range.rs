//! The range of values that colours stand for.

use super::colour::Values;

/// The share of distances that colours tell apart: the few that are greater by magnitude would leave the others one colour.
const USUAL: f64 = 0.99;
/// Bits of a number that make no difference to where it is counted: 7 of its 23 digits are left.
const COUNTED_AS_ONE: u32 = 16;

/// Facts about values by which their range is found.
#[derive(Clone, Default)]
pub(super) struct Spread {
    extremes: Option<[f32; 2]>,
    /// How many distances are as large by magnitude, in steps of less than a hundredth; none of other values.
    magnitudes: Vec<u32>,
}

impl Spread {
    /// Looks at values, of which those that are not finite do not count.
    pub(super) fn of(values: &[f32], kind: &Values<'_>) -> Self {
        let finite = || values.iter().copied().filter(|value| value.is_finite());
        let mut magnitudes = Vec::new();
        if matches!(kind, Values::Distance(_)) {
            magnitudes.resize(1 << (u32::BITS - 1 - COUNTED_AS_ONE), 0);
            finite().for_each(|value| magnitudes[(value.abs().to_bits() >> COUNTED_AS_ONE) as usize] += 1);
        }
        let extremes = finite().map(|value| [value; 2]).reduce(|[a, b], [c, d]| [a.min(c), b.max(d)]);
        Self { extremes, magnitudes }
    }

    /// Takes other values in.
    pub(super) fn join(&mut self, other: &Self) {
        let both = [self.extremes, other.extremes].into_iter().flatten();
        self.extremes = both.reduce(|[a, b], [c, d]| [a.min(c), b.max(d)]);
        self.magnitudes.resize(other.magnitudes.len(), 0);
        self.magnitudes.iter_mut().zip(&other.magnitudes).for_each(|(sum, count)| *sum += count);
    }

    /// The range of colours, and whether values go on beyond it: that of distances has zero in its middle.
    pub(super) fn range(&self) -> (Option<[f32; 2]>, bool) {
        let Some([lo, hi]) = self.extremes else { return (None, false) };
        if self.magnitudes.is_empty() {
            return (Some([lo, hi]), false);
        }
        let greatest = lo.abs().max(hi.abs());
        let all: u64 = self.magnitudes.iter().map(|&count| u64::from(count)).sum();
        let usual = (all as f64 * USUAL).ceil() as u64;
        let mut within = 0;
        let last = self.magnitudes.iter().position(|&count| {
            within += u64::from(count);
            within >= usual
        });
        // Where nearly all are nothing, the others are what there is to tell apart.
        let bound = match last {
            Some(last @ 1..) => f32::from_bits((last as u32 + 1) << COUNTED_AS_ONE).min(greatest),
            _ => greatest,
        };
        (Some([-bound, bound]), bound < greatest)
    }
}
