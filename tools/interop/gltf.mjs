// The script `gltf` in this folder runs these checks.
import fs from 'node:fs';
import validator from 'gltf-validator';
import { MeshoptDecoder } from 'meshoptimizer';

await MeshoptDecoder.ready;
const [, , plainPath, compressedPath] = process.argv;
let failed = false;
const demand = (holds, what) => {
    console.log(`${holds ? 'ok  ' : 'FAIL'} ${what}`);
    failed ||= !holds;
};

/** Returns the elements of every accessor, decoded and with the node's transformation applied. */
async function load(path) {
    const bytes = fs.readFileSync(path);
    const { issues } = await validator.validateBytes(new Uint8Array(bytes), { maxIssues: 20 });
    const errors = issues.messages.filter((m) => m.severity === 0).map((m) => `${m.code} ${m.pointer}`);
    demand(issues.numErrors === 0, `${path}: ${issues.numErrors} errors, ${issues.numWarnings} warnings ${errors}`);
    const jsonLength = bytes.readUInt32LE(12);
    const json = JSON.parse(bytes.toString('utf8', 20, 20 + jsonLength));
    if (!json.meshes) return { values: {}, positions: [], indices: [], error: 0, size: bytes.length };
    const binary = bytes.subarray(20 + jsonLength + 8);
    const types = { 5120: Int8Array, 5123: Uint16Array, 5125: Uint32Array, 5126: Float32Array };
    const widths = { SCALAR: 1, VEC2: 2, VEC3: 3, VEC4: 4 };
    const read = (index) => {
        const accessor = json.accessors[index];
        const view = json.bufferViews[accessor.bufferView];
        const packed = view.extensions?.EXT_meshopt_compression;
        const data = new Uint8Array(view.byteLength);
        if (packed) {
            const source = binary.subarray(packed.byteOffset, packed.byteOffset + packed.byteLength);
            MeshoptDecoder.decodeGltfBuffer(data, packed.count, packed.byteStride, source, packed.mode, packed.filter);
        } else {
            data.set(binary.subarray(view.byteOffset, view.byteOffset + view.byteLength));
        }
        const Type = types[accessor.componentType];
        const all = new Type(data.buffer);
        const width = widths[accessor.type];
        const stride = (view.byteStride ?? width * Type.BYTES_PER_ELEMENT) / Type.BYTES_PER_ELEMENT;
        const scale = accessor.normalized ? 1 / 127 : 1;
        return Array.from({ length: accessor.count }, (_, i) =>
            Array.from(all.subarray(i * stride, i * stride + width), (x) => x * scale));
    };
    const primitive = json.meshes[0].primitives[0];
    const values = Object.fromEntries(Object.entries(primitive.attributes).map(([name, i]) => [name, read(i)]));
    const { scale = [1, 1, 1], translation = [0, 0, 0], rotation } = json.nodes[0];
    const turned = ([x, y, z]) => (rotation ? [x, z, -y] : [x, y, z]);
    const positions = values.POSITION.map((p) =>
        turned(p.map((x, axis) => x * scale[axis])).map((x, axis) => x + translation[axis]));
    const error = json.asset.extras?.positionError ?? 0;
    return { values, positions, indices: read(primitive.indices).flat(), error, size: bytes.length };
}

/** Rotates each triangle so that its lowest index comes first, and sorts the triangles. */
const triangles = (indices) => {
    const all = [];
    for (let i = 0; i < indices.length; i += 3) {
        const t = indices.slice(i, i + 3);
        const k = t.indexOf(Math.min(...t));
        all.push([t[k], t[(k + 1) % 3], t[(k + 2) % 3]].join());
    }
    return all.sort().join(' ');
};
const greatest = (a, b, difference) => a.reduce((most, x, i) => Math.max(most, difference(x, b[i])), 0);

const plain = await load(plainPath);
if (compressedPath) {
    const packed = await load(compressedPath);
    demand(triangles(plain.indices) === triangles(packed.indices), `${plain.indices.length / 3} triangles are the same`);
    const off = greatest(plain.positions, packed.positions, (p, q) => Math.max(...p.map((x, i) => Math.abs(x - q[i]))));
    // The coordinates of the uncompressed file are also rounded, to f32.
    const rounding = greatest(plain.positions, plain.positions, (p) => Math.max(...p.map(Math.abs))) * 2 ** -23;
    demand(off <= packed.error + rounding, `positions are off by ${off}; the file states ${packed.error}`);
    for (const [name, values] of Object.entries(plain.values).filter(([name]) => name !== 'POSITION')) {
        const other = packed.values[name];
        if (name === 'NORMAL') {
            const length = (n) => Math.hypot(...n);
            const angle = greatest(values, other, (m, n) => {
                const cosine = m.reduce((sum, x, i) => sum + x * n[i], 0) / (length(m) * length(n));
                return (Math.acos(Math.min(1, cosine)) * 180) / Math.PI;
            });
            demand(angle < 1.5, `normals are off by ${angle.toFixed(2)} degrees`);
        } else {
            const relative = greatest(values, other, (v, w) =>
                Math.max(...v.map((x, i) => Math.abs(x - w[i]))) / Math.max(1e-30, ...v.map(Math.abs)));
            demand(relative <= 2 ** -14, `${name} is off by ${relative} of the greatest component`);
        }
    }
    console.log(`${plain.size} bytes plain, ${packed.size} compressed`);
}
process.exit(failed ? 1 : 0);
