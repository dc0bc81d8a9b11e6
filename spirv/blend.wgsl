// The adaptive blur: the blurred occupancy, scaled, where the greatest smoothed sample near by is at the threshold or below, smoothed from one and
// a half times that on, and a mean of both between.

struct Push {
    // Words of the field.
    words: u32,
    // The greatest sample that is outside.
    threshold: u32,
    // Of the fine field.
    scale: u32,
}

var<immediate> push: Push;
// Blurred occupancy.
@group(0) @binding(0) var<storage, read> fine: array<u32>;
@group(0) @binding(1) var<storage, read> smoothed: array<u32>;
// The greatest near by, to become the field.
@group(0) @binding(2) var<storage, read_write> field: array<u32>;

@compute @workgroup_size(256)
fn blend(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let word = id.x + 256u * groups.x * id.y;
    if word >= push.words {
        return;
    }
    let near = vec2(field[word] & 0xffffu, field[word] >> 16u);
    let blurred = vec2(fine[word] & 0xffffu, fine[word] >> 16u);
    let b = vec2(smoothed[word] & 0xffffu, smoothed[word] >> 16u);
    let a = max(min(blurred * push.scale >> vec2(FINE_BITS), vec2(FULL)), b);
    let whole = push.threshold + 1u;
    let share = min(2u * (max(near, vec2(push.threshold)) - push.threshold), vec2(whole));
    let sum = (whole - share) * a + share * b;
    let mean = (sum + whole / 2u) / whole;
    field[word] = mean.x | mean.y << 16u;
}
