// Arithmetic with unsigned 64-bit integers, as (low word, high word).

fn plus(a: vec2<u32>, b: vec2<u32>) -> vec2<u32> {
    let low = a.x + b.x;
    return vec2(low, a.y + b.y + u32(low < a.x));
}

fn minus(a: vec2<u32>, b: vec2<u32>) -> vec2<u32> {
    return vec2(a.x - b.x, a.y - b.y - u32(a.x < b.x));
}

fn less(a: vec2<u32>, b: vec2<u32>) -> bool {
    return a.y < b.y || (a.y == b.y && a.x < b.x);
}

// A shift to the left by n bits, where n is at most 63.
fn left(a: vec2<u32>, n: u32) -> vec2<u32> {
    if n == 0u {
        return a;
    }
    if n >= 32u {
        return vec2(0u, a.x << (n - 32u));
    }
    return vec2(a.x << n, (a.y << n) | (a.x >> (32u - n)));
}

// A shift to the right by n bits, where n is at most 63.
fn right(a: vec2<u32>, n: u32) -> vec2<u32> {
    if n == 0u {
        return a;
    }
    if n >= 32u {
        return vec2(a.y >> (n - 32u), 0u);
    }
    return vec2((a.x >> n) | (a.y << (32u - n)), a.y >> n);
}

fn leading_zeros(a: vec2<u32>) -> u32 {
    return select(countLeadingZeros(a.y), 32u + countLeadingZeros(a.x), a.y == 0u);
}

// All 64 bits of a product.
fn product(a: u32, b: u32) -> vec2<u32> {
    let low = (a & 0xffffu) * (b & 0xffffu);
    let middle = (a & 0xffffu) * (b >> 16u) + (low >> 16u);
    let other = (a >> 16u) * (b & 0xffffu) + (middle & 0xffffu);
    return vec2((other << 16u) | (low & 0xffffu), (a >> 16u) * (b >> 16u) + (middle >> 16u) + (other >> 16u));
}

// The lower 64 of the 128 bits of a product.
fn low_product(a: vec2<u32>, b: vec2<u32>) -> vec2<u32> {
    let first = product(a.x, b.x);
    return vec2(first.x, first.y + a.x * b.y + a.y * b.x);
}

// The upper 64 of the 128 bits of a product.
fn high_product(a: vec2<u32>, b: vec2<u32>) -> vec2<u32> {
    let cross = product(a.x, b.y);
    let other = product(a.y, b.x);
    let middle = plus(vec2(product(a.x, b.x).y, 0u), plus(vec2(cross.x, 0u), vec2(other.x, 0u)));
    let carried = plus(vec2(middle.y, 0u), plus(vec2(cross.y, 0u), vec2(other.y, 0u)));
    return plus(product(a.y, b.y), carried);
}
