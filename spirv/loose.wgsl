//! with ramp
// Reduces clouds in the bulk, so that the bulk does not hide sheets where they meet the bulk.

struct LoosePush {
    // The number of words in each field.
    words: u32,
    // Converts a smoothed sample to a fraction of the plateau: sample * scale / 16384 is the
    // fraction in 32768ths.
    scale: u32,
}

var<immediate> push: LoosePush;
// Clouds; replaced by the products of clouds and weights.
@group(0) @binding(0) var<storage, read_write> clouds: array<u32>;
// The clouds, smoothed by the filter that shows the bulk; replaced by the weights, in 32768ths.
// Weights below LEAST_WEIGHT are raised to this value.
@group(0) @binding(1) var<storage, read_write> smooth_clouds: array<u32>;

fn weight_of(smoothed: u32) -> u32 {
    let density = min((smoothed * push.scale) >> 14u, FULL);
    let slope = ((1u << 28u) + IN_BULK_RANGE - 1u) / IN_BULK_RANGE;
    return 4096u - ramp_at(density, Ramp(IN_BULK_BEGIN, IN_BULK_RANGE, slope));
}

@compute @workgroup_size(256)
fn loose(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let word = id.x + 256u * groups.x * id.y;
    if word >= push.words {
        return;
    }
    let all = clouds[word];
    let smoothed = smooth_clouds[word];
    let weights = vec2(weight_of(smoothed & 0xffffu), weight_of(smoothed >> 16u));
    let weighed = (vec2(all & 0xffffu, all >> 16u) * weights) >> vec2(12u);
    clouds[word] = weighed.x | weighed.y << 16u;
    let divisors = max(weights, vec2(LEAST_WEIGHT)) << vec2(3u);
    smooth_clouds[word] = divisors.x | divisors.y << 16u;
}
