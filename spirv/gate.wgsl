// How far one thing has given way to another: 0 to 4096, as 3 x^2 - 2 x^3 rises from 0 to 1.

struct Gate {
    begin: u32,
    range: u32,
    // 2^28 over the range, rounded up.
    slope: u32,
}

fn passed(value: u32, gate: Gate) -> u32 {
    let x = (min(max(value, gate.begin) - gate.begin, gate.range) * gate.slope) >> 16u;
    return (((x * x) >> 8u) * (12288u - 2u * x)) >> 16u;
}
