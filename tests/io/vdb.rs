//! Tests of .vdb files: a separate reader decodes each voxel, tile and value as OpenVDB's sources
//! do, and the tests compare the values with exact distances.

use std::collections::BTreeMap;
use std::fs;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use half::f16;
use meniscus::files::{GridInfo, Info, VolumeInfo, info};
use meniscus::internals::io::output::MeshFormat;
use meniscus::internals::io::vdb::read_grids;
use meniscus::internals::io::{CoordinateWidth, ReadFault};
use meniscus::internals::particles::{AttributeInfo, AttributeKind};
use meniscus::internals::surface::mesh::source::{Lattice, MeshSource, Outline, Vertices};
use meniscus::internals::surface::mesh::{Mesh, VertexAttribute};
use meniscus::{MemoryBudget, Reconstruction, Volume};

use crate::common::fill;
use crate::common::shapes::{cuboid, moved, sphere, union};

type Index = [i32; 3];

/// The content of a .vdb file. The reader must have read every byte of the file.
struct Archive {
    grids: Vec<Grid>,
}

/// The content of a grid.
struct Grid {
    name: String,
    tree: String,
    metadata: BTreeMap<String, (String, Vec<u8>)>,
    origin: [f64; 3],
    step: f64,
    background: Vec<f64>,
    /// The values of each tile, by the tile's edge and corner.
    tiles: BTreeMap<(i32, Index), Vec<f64>>,
    leaves: BTreeMap<Index, Leaf>,
}

struct Leaf {
    active: Vec<bool>,
    values: Vec<Vec<f64>>,
}

/// The masks and values of a node, which precede the node's children in the file.
struct Node {
    has_child: Vec<bool>,
    tiles: Vec<Vec<f64>>,
}

/// The form in which a file stores the values of a grid.
#[derive(Clone, Copy)]
struct Values {
    components: usize,
    /// Size of a number, in bytes.
    bytes: usize,
    /// Whether numbers are integers.
    whole: bool,
    half: bool,
    zip: bool,
}

struct Reader<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl Reader<'_> {
    fn take(&mut self, count: usize) -> &[u8] {
        self.at += count;
        &self.bytes[self.at - count..self.at]
    }
    fn array<const N: usize>(&mut self) -> [u8; N] {
        self.take(N).try_into().unwrap()
    }
    fn u32(&mut self) -> usize {
        u32::from_le_bytes(self.array()) as usize
    }
    fn i64(&mut self) -> i64 {
        i64::from_le_bytes(self.array())
    }
    fn f64(&mut self) -> f64 {
        f64::from_le_bytes(self.array())
    }
    fn vector(&mut self) -> [f64; 3] {
        [(); 3].map(|()| self.f64())
    }
    fn index(&mut self) -> Index {
        [(); 3].map(|()| i32::from_le_bytes(self.array()))
    }
    fn text(&mut self) -> String {
        let length = self.u32();
        String::from_utf8(self.take(length).to_vec()).unwrap()
    }
    fn mask(&mut self, bits: usize) -> Vec<bool> {
        let bytes = self.take(bits / 8);
        (0..bits).map(|i| bytes[i / 8] >> (i % 8) & 1 == 1).collect()
    }

    fn archive(mut self) -> Archive {
        assert_eq!(self.take(8), b" BDV\0\0\0\0");
        assert_eq!(self.u32(), 224);
        assert!(self.u32() >= 6 && self.u32() < 100, "the version of OpenVDB");
        assert_eq!(self.array(), [1], "the file must have grid offsets");
        let id = String::from_utf8(self.take(36).to_vec()).unwrap();
        let is_dash = |i| [8, 13, 18, 23].contains(&i);
        assert!(
            id.bytes()
                .enumerate()
                .all(|(i, b)| b == b'-' && is_dash(i) || b.is_ascii_hexdigit() && !is_dash(i))
        );
        assert_eq!(self.u32(), 0, "metadata of the file");
        let count = self.u32();
        let grids = (0..count).map(|_| self.grid()).collect();
        assert_eq!(self.at, self.bytes.len(), "bytes after the last grid");
        Archive { grids }
    }

    fn grid(&mut self) -> Grid {
        let (name, tree) = (self.text(), self.text());
        assert_eq!(self.text(), "", "the grid is an instance");
        let [begin, blocks, end] = [(); 3].map(|()| self.i64() as usize);
        assert_eq!(self.at, begin);
        let flags = self.u32();
        assert_eq!(flags & !1, 2, "compression {flags}");
        let count = self.u32();
        let metadata = (0..count).map(|_| {
            let (name, kind) = (self.text(), self.text());
            let length = self.u32();
            (name, (kind, self.take(length).to_vec()))
        });
        let metadata: BTreeMap<_, _> = metadata.collect();
        assert_eq!(metadata.len(), count, "two metadata entries have the same name");
        assert_eq!(self.text(), "UniformScaleTranslateMap");
        let origin = self.vector();
        let [size, edges, inverse, squares, halves] = [(); 5].map(|()| self.vector());
        let step = size[0];
        let expected =
            [step, step, 1.0 / step, 1.0 / (step * step), 0.5 / step].map(|number| [number; 3]);
        assert_eq!([size, edges, inverse, squares, halves], expected);

        let kind = tree.strip_prefix("Tree_").unwrap();
        let half = kind.ends_with("_HalfFloat");
        let kind = kind.strip_suffix("_HalfFloat").unwrap_or(kind);
        let (components, bytes, whole) = match kind.strip_suffix("_5_4_3").unwrap() {
            "float" => (1, 4, false),
            "vec3s" => (3, 4, false),
            "int32" => (1, 4, true),
            "int64" => (1, 8, true),
            other => panic!("unexpected tree of {other}"),
        };
        let values = Values { components, bytes, whole, half, zip: flags & 1 == 1 };
        assert_eq!(self.u32(), 1, "number of buffers of a leaf");
        let background = values.read(self.take(components * bytes), false);
        let mut grid = Grid {
            name,
            tree,
            metadata,
            origin,
            step,
            background: background[0].clone(),
            tiles: BTreeMap::new(),
            leaves: BTreeMap::new(),
        };
        let (tiles, children) = (self.u32(), self.u32());
        for _ in 0..tiles {
            let corner = self.index();
            let value = values.read(self.take(components * bytes), false).remove(0);
            assert_eq!(self.array(), [0], "a tile is active");
            grid.tiles.insert((4096, corner), value);
        }
        let mut leaves = Vec::new();
        for _ in 0..children {
            let corner = self.index();
            self.inner(&mut grid, values, corner, 4096, &mut leaves);
        }
        assert_eq!(self.at, blocks, "the offset of values");
        for (corner, mask) in leaves {
            assert_eq!(self.mask(512), mask, "the mask of leaf {corner:?}");
            let values = self.values(values, &grid.background, &mask);
            assert!(grid.leaves.insert(corner, Leaf { active: mask, values }).is_none());
        }
        assert_eq!(self.at, end, "the offset of the end");
        grid
    }

    /// Reads an inner node with this edge, and all nodes below it.
    fn inner(
        &mut self,
        grid: &mut Grid,
        values: Values,
        corner: Index,
        edge: i32,
        leaves: &mut Vec<(Index, Vec<bool>)>,
    ) {
        assert!(corner.iter().all(|at| at.rem_euclid(edge) == 0), "{corner:?} of {edge}");
        let slots: i32 = if edge == 4096 { 32 } else { 16 };
        let count = slots.pow(3) as usize;
        let has_child = self.mask(count);
        assert!(has_child.contains(&true), "a node without children at {corner:?}");
        assert!(!self.mask(count).contains(&true), "a tile is active");
        let tiles = self.values(values, &grid.background, &vec![false; count]);
        let node = Node { has_child, tiles };
        let child_edge = edge / slots;
        for i in 0..count {
            let n = i as i32;
            let at = [n / (slots * slots), n / slots % slots, n % slots];
            let child = std::array::from_fn(|axis| corner[axis] + at[axis] * child_edge);
            if !node.has_child[i] {
                grid.tiles.insert((child_edge, child), node.tiles[i].clone());
            } else if child_edge == 8 {
                let mask = self.mask(512);
                assert!(mask.contains(&true), "an empty leaf at {child:?}");
                leaves.push((child, mask));
            } else {
                self.inner(grid, values, child, child_edge, leaves);
            }
        }
    }

    /// Reads the values of a node. The file stores only the values of active voxels. All other
    /// values are the background or its negative.
    fn values(&mut self, values: Values, background: &[f64], active: &[bool]) -> Vec<Vec<f64>> {
        let negated: Vec<f64> = background.iter().map(|number| -number).collect();
        let [kind] = self.array();
        let inside = match kind {
            0 => vec![false; active.len()],
            1 => vec![true; active.len()],
            3 => self.mask(active.len()).into_iter().map(|outside| !outside).collect(),
            other => panic!("inactive values of kind {other}"),
        };
        let count = active.iter().filter(|active| **active).count();
        let stored = self.stored(values, count);
        let mut stored = stored.into_iter();
        let value = |(active, inside): (&bool, bool)| match (active, inside) {
            (true, _) => stored.next().unwrap(),
            (false, true) => negated.clone(),
            (false, false) => background.to_vec(),
        };
        active.iter().zip(inside).map(value).collect()
    }

    fn stored(&mut self, values: Values, count: usize) -> Vec<Vec<f64>> {
        let length = count * values.components * if values.half { 2 } else { values.bytes };
        // In half precision, OpenVDB reads no bytes for an array without values.
        if !values.zip || values.half && count == 0 {
            return values.read(self.take(length), values.half);
        }
        let zipped = self.i64();
        if zipped <= 0 {
            assert_eq!(-zipped, length as i64);
            return values.read(self.take(length), values.half);
        }
        let mut plain = Vec::new();
        let packed = self.take(zipped as usize);
        flate2::read::ZlibDecoder::new(packed).read_to_end(&mut plain).unwrap();
        assert_eq!(plain.len(), length);
        assert!(packed.len() < length, "compression must make values shorter");
        values.read(&plain, values.half)
    }
}

impl Values {
    fn read(self, bytes: &[u8], half: bool) -> Vec<Vec<f64>> {
        let width = if half { 2 } else { self.bytes };
        let number = |bytes: &[u8]| match (width, self.whole) {
            (2, _) => f16::from_le_bytes(bytes.try_into().unwrap()).to_f64(),
            (4, false) => f64::from(f32::from_le_bytes(bytes.try_into().unwrap())),
            (4, true) => f64::from(i32::from_le_bytes(bytes.try_into().unwrap())),
            _ => i64::from_le_bytes(bytes.try_into().unwrap()) as f64,
        };
        bytes
            .chunks(width * self.components)
            .map(|value| value.chunks(width).map(number).collect())
            .collect()
    }
}

impl Grid {
    /// The value of a voxel, and whether it is active.
    fn at(&self, index: Index) -> (&[f64], bool) {
        let corner = |edge: i32| index.map(|at| at.div_euclid(edge) * edge);
        if let Some(leaf) = self.leaves.get(&corner(8)) {
            let [x, y, z] = index.map(|at| at.rem_euclid(8) as usize);
            let i = (x * 8 + y) * 8 + z;
            return (&leaf.values[i], leaf.active[i]);
        }
        let tile =
            [8, 128, 4096].into_iter().find_map(|edge| self.tiles.get(&(edge, corner(edge))));
        (tile.map_or(&self.background, |value| value), false)
    }

    fn place(&self, index: Index) -> [f64; 3] {
        std::array::from_fn(|axis| self.origin[axis] + self.step * f64::from(index[axis]))
    }

    fn text(&self, name: &str) -> &str {
        let (kind, value) = &self.metadata[name];
        assert_eq!(kind, "string");
        str::from_utf8(value).unwrap()
    }

    fn active(&self) -> Vec<Index> {
        let voxels = |(corner, leaf): (&Index, &Leaf)| {
            let active: Vec<_> = (0..512).filter(|&i| leaf.active[i as usize]).collect();
            let [x, y, z] = *corner;
            active.into_iter().map(move |i: i32| [x + i / 64, y + i / 8 % 8, z + i % 8])
        };
        self.leaves.iter().flat_map(voxels).collect()
    }
}

/// A mesh whose source also provides the lattice of its samples, and a folder for scratch files.
struct OnLattice {
    mesh: Mesh,
    lattice: Option<Lattice>,
    folder: Option<PathBuf>,
}

impl MeshSource for OnLattice {
    fn outline(&self) -> Outline {
        Outline { lattice: self.lattice, ..self.mesh.outline() }
    }
    fn vertices(&self, piece: usize) -> io::Result<Vertices<'_>> {
        self.mesh.vertices(piece)
    }
    fn triangles(&self, piece: usize) -> io::Result<Vec<[u64; 3]>> {
        self.mesh.triangles(piece)
    }
    fn scratch_folder(&self) -> Option<&Path> {
        self.folder.as_deref()
    }
}

const LATTICE: Lattice = Lattice { origin: [0.03, -0.51, 7.0], step: 0.1 };

fn on_lattice(mesh: Mesh) -> OnLattice {
    OnLattice { mesh, lattice: Some(LATTICE), folder: None }
}

fn written(mesh: &dyn MeshSource, zip: bool) -> Vec<u8> {
    let mut bytes = Vec::new();
    MeshFormat::Vdb { zip }.write(&mut bytes, mesh, CoordinateWidth::F32).unwrap();
    bytes
}

fn decoded(bytes: &[u8]) -> Vec<Grid> {
    Reader { bytes, at: 0 }.archive().grids
}

fn length(vector: [f64; 3]) -> f64 {
    vector.iter().map(|x| x * x).sum::<f64>().sqrt()
}

fn minus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|axis| a[axis] - b[axis])
}

/// The distance of a point from a box, negative inside.
fn from_box(place: [f64; 3], low: [f64; 3], high: [f64; 3]) -> f64 {
    let beyond: [f64; 3] =
        std::array::from_fn(|axis| (low[axis] - place[axis]).max(place[axis] - high[axis]));
    let greatest = beyond.into_iter().fold(f64::MIN, f64::max);
    if greatest < 0.0 { greatest } else { length(beyond.map(|x| x.max(0.0))) }
}

type Body = (&'static str, Mesh, Box<dyn Fn([f64; 3]) -> f64>);

/// Closed meshes, each with a function for the exact distance.
fn bodies() -> Vec<Body> {
    let centre = [0.4, -1.3, 6.9];
    let ball = moved(&sphere(2.0, 6), centre);
    // A box with positive and negative coordinates. Along one axis, it is longer than a node of 128
    // voxels.
    let (low, high) = ([-3.21, -2.0, 2.5], [6.0, 3.33, 15.9]);
    // Two boxes that share an edge, and two balls that touch at a vertex.
    let (one, other) = ([[0.0, 0.0, 7.0], [1.5, 1.5, 9.0]], [[1.5, 1.5, 7.0], [3.0, 3.0, 9.0]]);
    let cubes = union(&cuboid(one[0], one[1]), &cuboid(other[0], other[1]));
    let second = [centre[0] + 3.0, centre[1], centre[2]];
    let balls = union(&moved(&sphere(2.0, 6), centre), &moved(&sphere(1.0, 5), second));
    vec![
        ("a ball", ball, Box::new(move |p| length(minus(p, centre)) - 2.0)),
        ("a box", cuboid(low, high), Box::new(move |p| from_box(p, low, high))),
        (
            "boxes with a common edge",
            cubes,
            Box::new(move |p| from_box(p, one[0], one[1]).min(from_box(p, other[0], other[1]))),
        ),
        (
            "balls that touch",
            balls,
            Box::new(move |p| (length(minus(p, centre)) - 2.0).min(length(minus(p, second)) - 1.0)),
        ),
    ]
}

#[test]
fn voxels_in_the_band_have_distances_and_other_voxels_have_a_side() {
    for (what, mesh, distance) in bodies() {
        let bytes = written(&on_lattice(mesh), false);
        let grids = decoded(&bytes);
        let [surface] = &grids[..] else { panic!("{} grids", grids.len()) };
        assert_eq!((&*surface.name, surface.text("name")), ("surface", "surface"));
        assert_eq!(surface.text("class"), "level set");
        assert_eq!(surface.tree, "Tree_float_5_4_3_HalfFloat");
        assert_eq!(surface.metadata["is_saved_as_half_float"], ("bool".to_owned(), vec![1]));
        assert_eq!((surface.origin, surface.step), (LATTICE.origin, LATTICE.step));
        let background = surface.background[0];
        assert!((background / 0.3 - 1.0).abs() < 1e-3, "{background}");

        let active = surface.active();
        let extreme = |pick: fn(i32, i32) -> i32| -> Index {
            active.iter().copied().reduce(|a, b| [0, 1, 2].map(|i| pick(a[i], b[i]))).unwrap()
        };
        let (low, high) = (extreme(i32::min), extreme(i32::max));
        let corner =
            |at: Index| ("vec3i".to_owned(), at.map(i32::to_le_bytes).as_flattened().to_vec());
        assert_eq!(surface.metadata["file_bbox_min"], corner(low), "{what}");
        assert_eq!(surface.metadata["file_bbox_max"], corner(high), "{what}");
        let count = (active.len() as i64).to_le_bytes().to_vec();
        assert_eq!(surface.metadata["file_voxel_count"], ("int64".to_owned(), count), "{what}");

        let (mut in_band, mut tiles, mut errors) = (0, 0, 0.0);
        for x in low[0] - 4..=high[0] + 4 {
            for y in low[1] - 4..=high[1] + 4 {
                for z in low[2] - 4..=high[2] + 4 {
                    let index = [x, y, z];
                    let exact = distance(surface.place(index)) / LATTICE.step;
                    let (value, is_active) = surface.at(index);
                    let voxels = value[0] / LATTICE.step;
                    // The triangles of a ball are up to 0.01 voxels inside the true ball.
                    if exact.abs() > 0.02 {
                        assert_eq!(voxels < 0.0, exact < 0.0, "{what}, {index:?}: {voxels}");
                    }
                    if is_active {
                        in_band += 1;
                        let error = (voxels - exact).abs();
                        assert!(error < 0.1, "{what}, {index:?}: {voxels}, not {exact}");
                        errors += error * error;
                    } else {
                        tiles += 1;
                        assert_eq!(value[0].abs(), background, "{what}, {index:?}");
                    }
                    if (exact.abs() - 3.0).abs() > 0.1 {
                        assert_eq!(is_active, exact.abs() < 3.0, "{what}, {index:?}: {exact}");
                    }
                }
            }
        }
        assert_eq!(in_band, active.len(), "{what}");
        let rms = (errors / in_band as f64).sqrt();
        assert!(rms < 0.02, "{what}: {rms} voxels");
        assert!(tiles > 1000, "{what}");
    }
}

/// A linear function of the position for each component.
fn linear(place: [f64; 3], component: usize) -> f64 {
    let [x, y, z] = place;
    let factors = [[0.3, -0.2, 0.1], [-0.1, 0.5, 0.2], [0.2, 0.2, -0.4]][component % 3];
    0.5 * component as f64 + factors[0] * x + factors[1] * y + factors[2] * z
}

#[test]
fn attributes_are_grids_of_their_values_at_the_nearest_point() {
    let (low, high) = ([0.0, 0.0, 7.0], [1.5, 1.1, 8.3]);
    let mut mesh = cuboid(low, high);
    let positions = mesh.positions.clone();
    let attribute = |name: &str, components: usize| {
        let values = positions.iter().flat_map(|&place| {
            (0..components).map(move |component| linear(place, component) as f32)
        });
        VertexAttribute::new(name, components, values.collect())
    };
    let whole = |name: &str, kind: AttributeKind, first: i64| {
        let whole: Vec<i64> = (0..8).map(|i| first + i).collect();
        let values = whole.iter().map(|&number| AttributeKind::word(number)).collect();
        VertexAttribute { kind, whole, ..VertexAttribute::new(name, 1, values) }
    };
    mesh.attributes = vec![
        attribute("velocity", 3),
        attribute("density", 1),
        attribute("pair", 2),
        attribute("tensor", 9),
        attribute("surface", 1),
        attribute("pair_0", 1),
        attribute("force", 3),
        whole("id", AttributeKind::Signed, -3),
        whole("key", AttributeKind::Unsigned, 4_000_000_000),
    ];
    let mut colour = attribute("rgba", 4);
    colour.kind = AttributeKind::Colour;
    colour.values = positions
        .iter()
        .flat_map(|&[x, y, _]| [x as f32 / 2.0, y as f32 / 2.0, 2.0, 0.5])
        .collect();
    mesh.attributes.push(colour);
    // The alpha of a second colour is stored.
    let tint = [51.0, 102.0, 255.0, 128.0].repeat(positions.len());
    let kind = AttributeKind::ByteColour;
    mesh.attributes.push(VertexAttribute { kind, ..VertexAttribute::new("tint", 4, tint) });
    for zip in [false, true] {
        let grids = decoded(&written(&on_lattice(mesh.clone()), zip));
        let names: Vec<(&str, &str)> =
            grids.iter().map(|grid| (&*grid.name, &*grid.tree)).collect();
        let (float, half) = ("Tree_float_5_4_3", "Tree_vec3s_5_4_3_HalfFloat");
        let tensor = ["0", "1", "2", "3", "4", "5", "6", "7", "8"].map(|c| format!("tensor_{c}"));
        let expected = [("surface", "Tree_float_5_4_3_HalfFloat"), ("v", half)]
            .into_iter()
            .chain([("density", float), ("pair_0", float), ("pair_1", float)])
            .chain(tensor.iter().map(|name| (&**name, float)))
            .chain([("surface_", float), ("pair_0_", float), ("force", "Tree_vec3s_5_4_3")])
            .chain([("id", "Tree_int32_5_4_3"), ("key", "Tree_int64_5_4_3"), ("Cd", half)])
            .chain(
                ["tint_0", "tint_1", "tint_2", "tint_3"]
                    .map(|name| (name, "Tree_float_5_4_3_HalfFloat")),
            );
        assert_eq!(names, expected.collect::<Vec<_>>());
        let surface = &grids[0];
        let active = surface.active();
        for grid in &grids[1..] {
            assert!(grid.active() == active, "{}", grid.name);
            assert_eq!(grid.text("class"), "unknown");
            // Programs must rotate vectors with the volume, but not colours.
            let vectors = match &*grid.name {
                "v" | "force" => Some("contravariant relative"),
                "Cd" => Some("invariant"),
                _ => None,
            };
            let found = grid.metadata.contains_key("vector_type").then(|| grid.text("vector_type"));
            assert_eq!(found, vectors, "{}", grid.name);
            assert!(grid.background.iter().all(|&number| number == 0.0));
            assert!(grid.tiles.values().flatten().all(|&number| number == 0.0), "{}", grid.name);
            let component: usize = grid.name.rsplit('_').next().unwrap().parse().unwrap_or(0);
            let component = if grid.name == "pair_0_" { 0 } else { component };
            for &index in &active {
                let place = surface.place(index);
                // Compare attributes only outside the box, where the nearest point of the box is
                // unique.
                let outside = surface.at(index).0[0] > 0.0;
                let nearest: [f64; 3] =
                    std::array::from_fn(|axis| place[axis].clamp(low[axis], high[axis]));
                let value = grid.at(index).0;
                match &*grid.name {
                    "id" => assert!((-3.0..5.0).contains(&value[0]) && value[0].fract() == 0.0),
                    "key" => assert!((4e9..4e9 + 8.0).contains(&value[0])),
                    "tint_0" | "tint_1" | "tint_2" | "tint_3" => {
                        let expected = [0.2, 0.4, 1.0, 128.0 / 255.0][component];
                        assert!((value[0] - expected).abs() < 1e-3, "{}: {value:?}", grid.name);
                    }
                    "Cd" if outside => {
                        let [x, y, _] = nearest;
                        assert!((value[0] - x / 2.0).abs() < 1e-3, "{value:?}");
                        assert!((value[1] - y / 2.0).abs() < 1e-3, "{value:?}");
                        assert_eq!(value[2], 1.0);
                    }
                    _ if outside => {
                        for (i, number) in value.iter().enumerate() {
                            let expected = linear(nearest, component + i);
                            let allowed = 1e-5 + if grid.name == "v" { 3e-3 } else { 0.0 };
                            assert!(
                                (number - expected).abs() < allowed,
                                "{} at {index:?}: {number}, not {expected}",
                                grid.name
                            );
                        }
                    }
                    _ => {}
                }
            }
        }
    }
}

/// A ball with velocities that exceed the range of half precision.
fn fast_ball() -> OnLattice {
    let mut mesh = moved(&sphere(1.0, 4), [0.0, 0.0, 7.0]);
    let values = (0..mesh.positions.len()).flat_map(|i| [i as f32, 0.5, -1e6]).collect();
    mesh.attributes = vec![VertexAttribute::new("velocity", 3, values)];
    on_lattice(mesh)
}

#[test]
fn scratch_files_change_no_byte_and_a_missing_folder_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let mut mesh = fast_ball();
    let values = (0..mesh.mesh.positions.len()).map(|i| i as f32 / 7.0).collect();
    mesh.mesh.attributes.push(VertexAttribute::new("heat", 1, values));
    let expected = [false, true].map(|zip| written(&mesh, zip));
    mesh.folder = Some(folder.path().to_owned());
    assert!([false, true].map(|zip| written(&mesh, zip)) == expected);
    assert_eq!(fs::read_dir(&folder).unwrap().count(), 0);
    mesh.folder = Some(folder.path().join("missing"));
    let mut bytes = Vec::new();
    let write = MeshFormat::Vdb { zip: false }.write(&mut bytes, &mesh, CoordinateWidth::F32);
    let message = write.unwrap_err().to_string();
    assert!(message.contains("scratch") && message.contains("missing"), "{message}");
    assert!(bytes.is_empty());
}

#[test]
fn compression_changes_no_value() {
    let mesh = fast_ball();
    let [plain, zipped] = [false, true].map(|zip| written(&mesh, zip));
    assert!(zipped.len() < plain.len());
    for (plain, zipped) in decoded(&plain).iter().zip(decoded(&zipped)) {
        assert_eq!((&plain.name, &plain.tree), (&zipped.name, &zipped.tree));
        assert_eq!(plain.active(), zipped.active());
        assert_eq!(plain.tiles, zipped.tiles);
        for (corner, leaf) in &plain.leaves {
            assert_eq!(leaf.values, zipped.leaves[corner].values);
        }
    }
    assert_eq!(decoded(&plain)[1].tree, "Tree_vec3s_5_4_3");
}

#[test]
fn threads_and_memory_change_no_byte_of_a_level_set() {
    let particles = fill(14.0, 2.0, 0.2, 3, |p| p.length() < 7.0);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.vdb");
    let bytes = |request: Reconstruction| {
        let surface = request.spacing(0.5).run(&particles[..]).unwrap();
        let _ = fs::remove_file(&path);
        surface.write(&path).unwrap();
        fs::read(&path).unwrap()
    };
    let expected = bytes(Reconstruction::new().threads(1));
    assert_eq!(decoded(&expected).len(), 1);
    assert!(bytes(Reconstruction::new().threads(2)) == expected, "two threads");
    let small = Reconstruction::new().threads(2).memory(MemoryBudget(24 << 20));
    assert!(bytes(small) == expected, "a small budget");
}

#[test]
fn a_volume_in_memory_has_the_bricks_and_distances_of_a_file() {
    let particles = fill(14.0, 2.0, 0.2, 3, |p| p.length() < 7.0);
    let surface = Reconstruction::new().spacing(0.5).run(&particles[..]).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.vdb");
    surface.write(&path).unwrap();
    let grids = decoded(&fs::read(&path).unwrap());
    let Volume { origin, voxel_size, corners, distances } = surface.volume().unwrap();
    assert_eq!((origin, voxel_size), (grids[0].origin, grids[0].step));
    let leaves: Vec<Index> = grids[0].leaves.keys().copied().collect();
    assert!(corners == leaves && corners.len() > 100, "{}", corners.len());
    for (corner, brick) in corners.iter().zip(distances.chunks(512)) {
        let values = &grids[0].leaves[corner].values;
        assert_eq!(brick.len(), values.len());
        for (i, (&distance, value)) in brick.iter().zip(values).enumerate() {
            let error = (f64::from(distance) - value[0]).abs() / voxel_size;
            assert!(error < 2e-3, "{corner:?}, {i}: {distance}, not {}", value[0]);
        }
    }
}

#[test]
fn only_unusual_names_of_grids_are_reported() {
    let infos = [("velocity", 3), ("color", 3), ("surface", 1), ("heat", 1)];
    let infos = infos.map(|(name, components)| match name {
        "color" => AttributeInfo { kind: AttributeKind::Colour, ..AttributeInfo::new(name, 3) },
        _ => AttributeInfo::new(name, components),
    });
    let [[from, to]] = &MeshFormat::Vdb { zip: false }.renamed(&infos, false)[..] else {
        panic!("expected one renamed attribute");
    };
    assert_eq!(from, "surface");
    assert_ne!(to, "surface");
}

#[test]
fn a_mesh_without_triangles_is_a_grid_without_voxels() {
    for lattice in [None, Some(LATTICE)] {
        for zip in [false, true] {
            let grids =
                decoded(&written(&OnLattice { mesh: Mesh::default(), lattice, folder: None }, zip));
            assert_eq!(grids.len(), 1);
            assert!(grids[0].active().is_empty() && grids[0].tiles.is_empty());
        }
    }
}

#[test]
fn a_mesh_without_a_lattice_or_with_a_nan_coordinate_makes_no_file() {
    let cube = cuboid([0.0; 3], [1.0; 3]);
    let mut broken = cube.clone();
    broken.positions[3][1] = f64::NAN;
    for mesh in [OnLattice { mesh: cube, lattice: None, folder: None }, on_lattice(broken)] {
        let mut bytes = Vec::new();
        let format = MeshFormat::Vdb { zip: false };
        let fault = format.write(&mut bytes, &mesh, CoordinateWidth::F32).unwrap_err();
        assert_eq!((fault.kind(), bytes.len()), (io::ErrorKind::InvalidInput, 0));
    }
}

fn small_file() -> Vec<u8> {
    let mut mesh = cuboid([0.0, 0.0, 7.0], [1.0, 1.0, 8.0]);
    mesh.attributes = vec![VertexAttribute::new("velocity", 3, vec![0.5; 24])];
    written(&on_lattice(mesh), true)
}

#[test]
fn info_returns_the_grids_of_a_file() {
    let bytes = small_file();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.VDB");
    fs::write(&path, &bytes).unwrap();
    let Info::Volume(VolumeInfo { grids, .. }) = info(&path).unwrap() else { panic!("no volume") };
    let found: Vec<_> = grids
        .iter()
        .map(|GridInfo { name, class, value_type, half, .. }| {
            (&**name, &**class, &**value_type, *half)
        })
        .collect();
    assert_eq!(found, [("surface", "level set", "float", true), ("v", "unknown", "vec3s", true)]);
    for (grid, decoded) in grids.iter().zip(decoded(&bytes)) {
        let active = decoded.active();
        assert_eq!(grid.active_voxels, Some(active.len() as u64));
        assert_eq!(grid.voxel_size, Some([0.1; 3]));
        let [low, high] = grid.index_bounds.unwrap();
        assert_eq!(grid.bounds.unwrap(), [decoded.place(low), decoded.place(high)]);
        assert!(active.iter().all(|at| (0..3).all(|i| low[i] <= at[i] && at[i] <= high[i])));
    }
}

#[test]
fn a_damaged_file_is_refused_or_read_and_never_a_panic() {
    let bytes = small_file();
    let whole = read_grids(bytes[..].into()).unwrap();
    for length in 0..bytes.len() {
        assert!(read_grids(bytes[..length].into()).is_err(), "{length} of {}", bytes.len());
    }
    let mut damaged = bytes.clone();
    for at in 0..bytes.len().min(3000) {
        for flip in [1, 0x80, 0xff] {
            damaged[at] ^= flip;
            let _ = read_grids(damaged[..].into());
            damaged[at] ^= flip;
        }
    }
    assert_eq!(read_grids(damaged[..].into()).unwrap(), whole);
    // Other versions, and files without grid offsets, are unsupported.
    for (at, value) in [(8, 221), (8, 225), (20, 0)] {
        damaged[at] = value;
        let fault = read_grids(damaged[..].into()).unwrap_err();
        assert!(matches!(fault, ReadFault::Unsupported(_)), "{fault}");
        damaged.clone_from(&bytes);
    }
}
