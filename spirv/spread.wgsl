//! with block mirror axis
// One axis of a dilation: the greatest of the samples within reach.

fn weight_of(k: i32) -> u32 {
    return u32(k <= i32(push.reach));
}

fn first_sum() -> u32 {
    return 0u;
}

fn with_tap(greatest: vec4<u32>, weights: vec4<u32>, sample: u32) -> vec4<u32> {
    return max(greatest, weights * sample);
}

fn finished(greatest: vec4<u32>) -> vec4<u32> {
    return greatest;
}

@compute @workgroup_size(256)
fn spread(@builtin(global_invocation_id) id: vec3<u32>) {
    filter_run(id.y, id.x);
}
