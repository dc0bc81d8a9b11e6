// How far one thing has given way to another: 0 to 4096, as 3 x^2 - 2 x^3 rises from 0 to 1.

fn passed(value: u32, begin: u32, range: u32) -> u32 {
    let x = min(max(value, begin) - begin, range) * 4096u / range;
    return (((x * x) >> 8u) * (12288u - 2u * x)) >> 16u;
}
