// Computes the calm and the fine surface of the bulk. The samples are smoothed with three widths.
// Each surface is extrapolated to width 0 from the depths of two widths.

struct DepthsOfPush {
    // The number of words in each field.
    words: u32,
    // Converts samples to fractions of the plateau: sample * scale / 16384 is the fraction in
    // 32768ths.
    scale: u32,
    // For each width, the standard deviation of a smoothed particle in 4096ths of a spacing, and
    // the maximum distance in 32768ths of this standard deviation.
    narrow_width: i32,
    middle_width: i32,
    wide_width: i32,
    narrow_most: i32,
    middle_most: i32,
    wide_most: i32,
    // For each surface, the factor of the extrapolation to width 0, in 4096ths. The distance of a
    // surface is near + factor * (near - far), where near and far are the distances that follow
    // from the narrower and the wider of its two widths.
    fine_share: i32,
    calm_share: i32,
}

var<immediate> push: DepthsOfPush;
// The samples smoothed with each width. They are replaced by the fine surface (`narrow`), the
// difference between the two surfaces (`middle`), and the calm surface (`wide`).
@group(0) @binding(0) var<storage, read_write> narrow: array<u32>;
@group(0) @binding(1) var<storage, read_write> middle: array<u32>;
@group(0) @binding(2) var<storage, read_write> wide: array<u32>;
// The inverse of the normal distribution function.
@group(0) @binding(3) var<storage, read> depths: array<i32>;

fn depth(sample: u32, width: i32, most: i32) -> i32 {
    let share = min((sample * push.scale) >> 14u, 32768u);
    let at = share >> 5u;
    let low = depths[at];
    let deviations = 4 * low + (((depths[at + 1u] - low) * i32(share & 31u)) >> 3u);
    return (clamp(deviations, -most, most) * width) >> 14u;
}

fn beyond(near: i32, far: i32, share: i32) -> i32 {
    let distance = near + (((near - far) * share + 2048) >> 12u);
    return clamp(distance + DISTANCE_ZERO, 1, 65535);
}

// Returns the fine surface, the difference between the surfaces, and the calm surface.
fn surfaces(shares: vec3<u32>) -> vec3<u32> {
    let a = depth(shares.x, push.narrow_width, push.narrow_most);
    let b = depth(shares.y, push.middle_width, push.middle_most);
    let c = depth(shares.z, push.wide_width, push.wide_most);
    let fine = beyond(a, b, push.fine_share);
    let calm = beyond(b, c, push.calm_share);
    let apart = clamp(fine - calm, -MOST_APART, MOST_APART) + DISTANCE_ZERO;
    return vec3(u32(fine), u32(apart), u32(calm));
}

@compute @workgroup_size(256)
fn depths_of(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let word = id.x + 256u * groups.x * id.y;
    if word >= push.words {
        return;
    }
    let shares = vec3(narrow[word], middle[word], wide[word]);
    let low = surfaces(shares & vec3(0xffffu));
    let high = surfaces(shares >> vec3(16u));
    let both = low | high << vec3(16u);
    narrow[word] = both.x;
    middle[word] = both.y;
    wide[word] = both.z;
}
