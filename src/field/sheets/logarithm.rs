//! Binary logarithms and powers of 2 in integers, by polynomials that shaders compute identically.

use super::BITS;

/// Fraction bits of a mantissa.
const MANTISSA: u32 = 15;

/// The coefficients a to d, in 32768ths, of log2(1 + x) = x + x (1 - x) (a + b x + c x^2 + d x^3).
/// The error is at most 4e-5.
pub const LOG2: [i32; 4] = [14492, -8811, 4924, -1484];

/// The coefficients a to c, in 32768ths, of 2^x = 1 + x - x (1 - x) (a + b x + c x^2). The error is
/// at most 1e-5.
pub const EXP2: [i32; 3] = [10058, 2148, 449];

/// A polynomial times x (1 - x), in 32768ths.
#[inline(always)]
fn between<const N: usize>(coefficients: &[i32; N], x: i32) -> i32 {
    let mut sum = 0;
    for &coefficient in coefficients.iter().rev() {
        sum = coefficient + ((sum * x) >> MANTISSA);
    }
    (((x * ((1 << MANTISSA) - x)) >> MANTISSA) * sum) >> MANTISSA
}

/// The binary logarithm of a sample; for a sample of 0, the logarithm of 1.
#[inline(always)]
pub fn log2(sample: u16) -> i32 {
    // An f32 represents every sample exactly, so its exponent and mantissa are exact.
    let bits = f32::from(sample.max(1)).to_bits();
    let power = (bits >> 23) as i32 - 127;
    let x = ((bits >> (23 - MANTISSA)) & ((1 << MANTISSA) - 1)) as i32;
    (power << BITS) + ((x + between(&LOG2, x)) >> (MANTISSA - BITS))
}

/// 2 to a power, which must be at least -16 and less than 3. The result is in 32768ths.
#[inline(always)]
pub fn exp2(power: i32) -> i32 {
    let whole = power >> BITS;
    let x = (power & ((1 << BITS) - 1)) << (MANTISSA - BITS);
    let mantissa = (1 << MANTISSA) + x - between(&EXP2, x);
    if whole >= 0 { mantissa << whole } else { mantissa >> -whole }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn integer_log2_and_exp2_are_accurate_to_a_few_units() {
        let one = f64::from(1 << BITS);
        for sample in 1..=u16::MAX {
            let error = f64::from(log2(sample)) - f64::from(sample).log2() * one;
            assert!(error.abs() < 1.3, "{sample}: {error}");
        }
        for power in -(15 << BITS)..(2 << BITS) {
            let error = f64::from(exp2(power)) - (f64::from(power) / one).exp2() * 32768.0;
            assert!(error.abs() < 6.0, "{power}: {error}");
        }
    }
}
