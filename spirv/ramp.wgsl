// A smooth ramp from 0 at `begin` to 4096 at `begin` + `range`: 4096 (3 x^2 - 2 x^3), where x rises
// from 0 to 1.

struct Ramp {
    begin: u32,
    range: u32,
    // 2^28 / `range`, rounded up.
    slope: u32,
}

fn ramp_at(value: u32, ramp: Ramp) -> u32 {
    let x = (min(max(value, ramp.begin) - ramp.begin, ramp.range) * ramp.slope) >> 16u;
    return (((x * x) >> 8u) * (12288u - 2u * x)) >> 16u;
}
