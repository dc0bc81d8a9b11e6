// One axis of a separable operation, which a shader defines by its functions `weight_of` and
// `with_tap`. Samples are mirrored at walls. A thread computes a run of RUN pairs of cells along
// the axis, so that it reads each sample once for all pairs.

struct AxisPush {
    // The coordinates of the planes at which fields are mirrored, in units of half a cell.
    mirror_lo: vec3<i32>,
    axis: u32,
    mirror_hi: vec3<i32>,
    reach: u32,
    // The number of cells at each face of the block that are not computed.
    margin: vec3<u32>,
    // The number of bits by which sums are shifted right; used only by shaders that compute sums.
    shift: u32,
}

var<immediate> push: AxisPush;
@group(0) @binding(0) var<storage, read> blocks: array<Block>;
@group(0) @binding(1) var<storage, read> samples: array<u32>;
@group(0) @binding(2) var<storage, read_write> filtered: array<u32>;

// The results of eight cells so far, and the weight of the last tap for each cell. Along x, `a`
// has the first four cells of the run, and `b` the last four. Along the other axes, `a` has the
// first cell of each pair, and `b` the second.
struct Run {
    a: vec4<u32>,
    b: vec4<u32>,
    a_weights: vec4<u32>,
    b_weights: vec4<u32>,
}

// Adds a tap that is `k` cells from the first cell of the run.
fn with_next(run: Run, k: i32, samples: vec2<u32>) -> Run {
    var next = run;
    let weight = weight_of(k);
    next.a_weights = vec4(weight, run.a_weights.xyz);
    if push.axis == 0u {
        next.b_weights = vec4(run.a_weights.w, run.b_weights.xyz);
    } else {
        next.b_weights = next.a_weights;
    }
    next.a = with_tap(run.a, next.a_weights, samples.x);
    next.b = with_tap(run.b, next.b_weights, samples.y);
    return next;
}

// Computes run number `number` of a block, if there is such a run.
fn filter_run(number_of_block: u32, number: u32) {
    let block = blocks[number_of_block];
    // A pair is computed if at least one of its cells is needed.
    var lo = max(vec3<i32>(push.margin), (push.mirror_lo >> vec3(1u)) - block.lo);
    var hi = min(
        vec3<i32>(block.size) - vec3<i32>(push.margin),
        ((push.mirror_hi + 1) >> vec3(1u)) - block.lo,
    );
    lo.x &= ~1;
    hi.x = (hi.x + 1) & ~1;
    var runs = vec3<u32>(max(hi - lo, vec3(0)));
    runs.x /= 2u;
    runs[push.axis] = (runs[push.axis] + RUN - 1u) / RUN;
    if number >= runs.x * runs.y * runs.z {
        return;
    }
    let row = number / runs.x;
    var at = vec3(number % runs.x, row % runs.y, row / runs.y);
    at[push.axis] *= RUN;
    at.x *= 2u;
    at += vec3<u32>(lo);
    // The mirrors along this axis, relative to the block. Taps of cells that are not needed can lie
    // beyond the block; they are clamped to the block.
    let last = i32(block.size[push.axis]) - 1;
    let mirrors = vec2(push.mirror_lo[push.axis], push.mirror_hi[push.axis])
        - 2 * block.lo[push.axis];
    let reach = i32(push.reach);
    let centre = i32(at[push.axis]);
    var run = Run(vec4(first_sum()), vec4(first_sum()), vec4(0u), vec4(0u));
    if push.axis == 0u {
        let begin = word_of(block, vec3(0u, at.y, at.z));
        for (var k = -reach; k < reach + 2 * i32(RUN); k++) {
            let x = u32(clamp(source_of(centre + k, mirrors.x, mirrors.y), 0, last));
            let sample = half_of(samples[begin + x / 2u], x);
            run = with_next(run, k, vec2(sample));
        }
        let a = finished(run.a);
        let b = finished(run.b);
        let words = vec4(a.x | a.y << 16u, a.z | a.w << 16u, b.x | b.y << 16u, b.z | b.w << 16u);
        for (var i = 0u; i < RUN && i32(at.x + 2u * i) < hi.x; i++) {
            filtered[begin + at.x / 2u + i] = words[i];
        }
    } else {
        var origin = at;
        origin[push.axis] = 0u;
        let begin = word_of(block, origin);
        let step = select(block.size.x / 2u * block.size.y, block.size.x / 2u, push.axis == 1u);
        for (var k = -reach; k < reach + i32(RUN); k++) {
            let source = source_of(centre + k, mirrors.x, mirrors.y);
            let word = samples[begin + step * u32(clamp(source, 0, last))];
            run = with_next(run, k, vec2(word & 0xffffu, word >> 16u));
        }
        let words = finished(run.a) | finished(run.b) << vec4(16u);
        for (var i = 0u; i < RUN && centre + i32(i) < hi[push.axis]; i++) {
            filtered[begin + step * (at[push.axis] + i)] = words[i];
        }
    }
}
