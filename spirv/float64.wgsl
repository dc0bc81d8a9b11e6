// IEEE 754 double precision in integer arithmetic, which gives the same results on every device.
// Numbers are (low word, high word). Results are rounded to the nearest number, ties to even.
// Shaders that include this file must also include `wide`.

// The number significand * 2^exponent. In `sign`, only the sign bit can be set.
struct Parts {
    significand: vec2<u32>,
    exponent: i32,
    sign: u32,
}

const SIGN: u32 = 0x80000000u;
const EXPONENT: u32 = 0x7ff00000u;

fn is_finite(a: vec2<u32>) -> bool {
    return (a.y & EXPONENT) != EXPONENT;
}

fn parts_of(a: vec2<u32>) -> Parts {
    let biased = (a.y & EXPONENT) >> 20u;
    let hidden = select(0x100000u, 0u, biased == 0u);
    return Parts(vec2(a.x, (a.y & 0xfffffu) | hidden), max(i32(biased), 1) - 1075, a.y & SIGN);
}

// The parts of a number, normalised so that the significand's highest bit is set, unless the
// significand is 0.
fn normalised(a: vec2<u32>) -> Parts {
    let parts = parts_of(a);
    let shift = min(leading_zeros(parts.significand), 63u);
    return Parts(left(parts.significand, shift), parts.exponent - i32(shift), parts.sign);
}

// A shift to the right; the lowest bit is set if any bit was lost.
fn right_sticky(a: vec2<u32>, n: u32) -> vec2<u32> {
    if n > 63u {
        return vec2(u32(any(a != vec2(0u))), 0u);
    }
    let shifted = right(a, n);
    return vec2(shifted.x | u32(any(left(shifted, n) != a)), shifted.y);
}

// The number nearest to significand * 2^exponent. If earlier steps lost bits, they must have set
// the lowest bit of the significand.
fn rounded(sign: u32, significand: vec2<u32>, exponent: i32) -> vec2<u32> {
    if all(significand == vec2(0u)) {
        return vec2(0u, sign);
    }
    let shift = leading_zeros(significand);
    var bits = left(significand, shift);
    var biased = exponent - i32(shift) + 63 + 1023;
    if biased > 2046 {
        return vec2(0u, sign | EXPONENT);
    }
    if biased < 1 {
        bits = right_sticky(bits, u32(1 - biased));
        biased = 1;
    }
    let rest = bits.x & 0x7ffu;
    bits = right(bits, 11u);
    bits = plus(bits, vec2(u32(rest + (bits.x & 1u) > 0x400u), 0u));
    // The hidden bit, if it is set, carries into the exponent and adds the missing 1.
    return vec2(bits.x, sign | (bits.y + (u32(biased - 1) << 20u)));
}

fn f64_add(a: vec2<u32>, b: vec2<u32>) -> vec2<u32> {
    if !is_finite(a) || !is_finite(b) {
        // The sum of two non-finite numbers is NaN, unless they are equal infinities.
        let none = !is_finite(a) && !is_finite(b) && any(a != b);
        return select(select(a, b, is_finite(a)), vec2(1u, EXPONENT), none);
    }
    var first = parts_of(a);
    var second = parts_of(b);
    if first.exponent < second.exponent {
        let other = first;
        first = second;
        second = other;
    }
    let x = left(first.significand, 10u);
    let y = right_sticky(left(second.significand, 10u), u32(first.exponent - second.exponent));
    let exponent = first.exponent - 10;
    if first.sign == second.sign {
        return rounded(first.sign, plus(x, y), exponent);
    }
    if less(x, y) {
        return rounded(second.sign, minus(y, x), exponent);
    }
    return rounded(select(first.sign, 0u, all(x == y)), minus(x, y), exponent);
}

fn f64_sub(a: vec2<u32>, b: vec2<u32>) -> vec2<u32> {
    return f64_add(a, vec2(b.x, b.y ^ SIGN));
}

// Multiplies finite numbers.
fn f64_mul(a: vec2<u32>, b: vec2<u32>) -> vec2<u32> {
    let x = normalised(a);
    let y = normalised(b);
    let low = low_product(x.significand, y.significand);
    let high = high_product(x.significand, y.significand);
    let bits = vec2(high.x | u32(any(low != vec2(0u))), high.y);
    return rounded(x.sign ^ y.sign, bits, x.exponent + y.exponent + 64);
}

// The quotient a / b. The divisor must be finite and not 0. `reciprocal` must be (2^116 - 1)
// divided by the divisor's significand of 53 bits, rounded down.
fn f64_div(a: vec2<u32>, b: vec2<u32>, reciprocal: vec2<u32>) -> vec2<u32> {
    if !is_finite(a) {
        return vec2(a.x, a.y ^ (b.y & SIGN));
    }
    let x = normalised(a);
    let y = normalised(b);
    // At first, `quotient` is floor(x 2^55 / y) or 1 less, for the significands x and y.
    var quotient = right(high_product(x.significand, reciprocal), 8u);
    let divisor = right(y.significand, 11u);
    var rest = minus(vec2(0u, right(x.significand, 11u).x << 23u), low_product(quotient, divisor));
    if !less(rest, divisor) {
        quotient = plus(quotient, vec2(1u, 0u));
        rest = minus(rest, divisor);
    }
    let bits = left(quotient, 1u);
    let lost = u32(any(rest != vec2(0u)));
    return rounded(x.sign ^ y.sign, vec2(bits.x | lost, bits.y), x.exponent - y.exponent - 56);
}

// The quotient a / b for 0 < a < b < 2^17.
fn f64_ratio(a: u32, b: u32) -> vec2<u32> {
    var shift = countLeadingZeros(a) - countLeadingZeros(b);
    shift -= u32(a << shift >= b);
    var rest = a << shift;
    var quotient = vec2(0u);
    for (var digit = 0; digit < 4; digit++) {
        rest <<= 15u;
        quotient = left(quotient, 15u) | vec2(rest / b, 0u);
        rest %= b;
    }
    quotient = left(quotient, 1u) | vec2(u32(rest != 0u), 0u);
    return rounded(0u, quotient, -61 - i32(shift));
}

// The number a / 2.
fn f64_half(a: i32) -> vec2<u32> {
    return rounded(bitcast<u32>(a) & SIGN, vec2(u32(abs(a)), 0u), -1);
}

// Whether a <= b. Neither number may be NaN.
fn f64_at_most(a: vec2<u32>, b: vec2<u32>) -> bool {
    if (((a.y | b.y) & ~SIGN) | a.x | b.x) == 0u {
        return true;
    }
    if ((a.y ^ b.y) & SIGN) != 0u {
        return (a.y & SIGN) != 0u;
    }
    if (a.y & SIGN) != 0u {
        return !less(a, b);
    }
    return !less(b, a);
}

fn f64_max(a: vec2<u32>, b: vec2<u32>) -> vec2<u32> {
    return select(a, b, f64_at_most(a, b));
}

fn f64_min(a: vec2<u32>, b: vec2<u32>) -> vec2<u32> {
    return select(a, b, f64_at_most(b, a));
}

// The functions below take and return single-precision numbers as their bits.
fn f64_from_f32(a: u32) -> vec2<u32> {
    let sign = a & SIGN;
    var biased = i32((a >> 23u) & 0xffu) + 896;
    var fraction = a & 0x7fffffu;
    if biased == 896 + 255 {
        biased = 2047;
    } else if biased == 896 {
        if fraction == 0u {
            return vec2(0u, sign);
        }
        let shift = countLeadingZeros(fraction) - 8u;
        fraction = (fraction << shift) & 0x7fffffu;
        biased = 897 - i32(shift);
    }
    return vec2(fraction << 29u, sign | (u32(biased) << 20u) | (fraction >> 3u));
}

// The number must not be NaN.
fn f32_from_f64(a: vec2<u32>) -> u32 {
    let sign = a.y & SIGN;
    let parts = parts_of(a);
    var biased = parts.exponent + 1075 - 896;
    if biased > 254 {
        return sign | 0x7f800000u;
    }
    var bits = left(parts.significand, 11u);
    if biased < 1 {
        bits = right_sticky(bits, u32(1 - biased));
        biased = 1;
    }
    let kept = bits.y >> 8u;
    let rest = (bits.y << 24u) | u32(bits.x != 0u);
    return sign | (kept + (u32(biased - 1) << 23u) + u32((rest | (kept & 1u)) > SIGN));
}
