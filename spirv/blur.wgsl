//! with block mirror axis
// One axis of a separable filter: (sum over taps of weight * sample + 2^(shift - 1)) >> shift, at
// most 65535.

// The weight of the centre, followed by the weights of the cells at distances 1, 2, ... on each
// side.
@group(0) @binding(3) var<storage, read> half_weights: array<u32>;

fn weight_of(k: i32) -> u32 {
    if k > i32(push.reach) {
        return 0u;
    }
    return half_weights[abs(k)];
}

fn first_sum() -> u32 {
    return 1u << (push.shift - 1u);
}

fn with_tap(sums: vec4<u32>, weights: vec4<u32>, sample: u32) -> vec4<u32> {
    return sums + weights * sample;
}

fn finished(sums: vec4<u32>) -> vec4<u32> {
    return min(sums >> vec4(push.shift), vec4(FULL));
}

@compute @workgroup_size(256)
fn blur(@builtin(global_invocation_id) id: vec3<u32>) {
    filter_run(id.y, id.x);
}
