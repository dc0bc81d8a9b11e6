// An inclusive prefix sum over the threads of a work group.

const GROUP: u32 = 256u;
var<workgroup> sums: array<vec3<u32>, GROUP>;

fn scanned(i: u32, own: vec3<u32>) -> vec3<u32> {
    sums[i] = own;
    for (var step = 1u; step < GROUP; step *= 2u) {
        workgroupBarrier();
        var below = vec3(0u);
        if i >= step {
            below = sums[i - step];
        }
        workgroupBarrier();
        sums[i] += below;
    }
    return sums[i];
}
