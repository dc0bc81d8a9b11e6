//! Fuzzes meshing and simplification with random fields.

use glam::{DVec3, IVec3};
use meniscus::internals::backend::{Cpu, Executor, Surfaces};
use meniscus::internals::brick::{BrickSide, Census, DifField, FrameFacts, PageInfo};
use meniscus::internals::field::indicator::{Indicator, IndicatorKind, SampledDif};
use meniscus::internals::field::recipe::{PaperFilters, Recipe};
use meniscus::internals::frame::{Detail, Normals};
use meniscus::internals::grid::units::{Isovalue, MemoryBudget, Sigma, Tolerance};
use meniscus::internals::grid::{BIN, CellBox, Grid, PeriodicMesh};
use meniscus::internals::surface::mesh::BlockMesh;
use meniscus::internals::surface::mesh::spool::Spool;
use meniscus::internals::surface::simplify::{Reduction, TriangleSpace, simplify};
use meniscus::internals::surface::stitch::StitchedSurface;
use meniscus::internals::system::control::{Control, Stage};
use meniscus::mesh::{Mesh, MeshSource, check, compare, measure};

use super::Target;

pub fn targets() -> Vec<Target> {
    let seeds = || {
        let noise = |seed: u32| {
            (0..400_u32)
                .map(|i| (i.wrapping_mul(2_654_435_761).wrapping_add(seed) >> 13) as u8)
                .collect()
        };
        vec![noise(1), noise(77), (0..=255).collect()]
    };
    vec![Target { name: "fields", runs: 300, run, seeds, words: &[] }]
}

/// Number of samples along an edge of the cube that the bytes fill.
const EDGE: i32 = 9;

/// Meshes and simplifies a field. The bytes are the isovalue, the tolerance, the position of the
/// samples, the options that remove components and drops, and the samples.
fn run(data: &[u8]) {
    let Some(([iso, tolerance, place, drops], samples)) = data.split_first_chunk::<4>() else {
        return;
    };
    let Ok(iso) = Isovalue::new((f64::from(*iso) + 0.5) / 256.0) else { return };
    // Place the samples within a block, or across the corner where eight blocks or bins meet.
    let lowest = IVec3::splat([0, -EDGE / 2, BIN - 3, 32 - EDGE / 2][usize::from(place & 3)]);
    let sample = |cell: IVec3| {
        let local = cell - lowest;
        let inside = local.min_element() >= 0 && local.max_element() < EDGE;
        let at = (local.x + EDGE * (local.y + EDGE * local.z)) as usize;
        if inside { samples.get(at).map_or(0, |&byte| u16::from(byte) * 257) } else { 0 }
    };
    let surface = || surface_of(lowest, iso, sample);
    let whole = surface().to_mesh().unwrap();
    assert_watertight(&whole, "stitched");
    let tolerance = [0.05, 0.25, 0.5, 2.0][usize::from(tolerance & 3)];
    let reduction = Reduction {
        tolerance: Some(Tolerance::new(tolerance).unwrap()),
        smallest_component: (drops & 1 == 1).then_some(4.0),
        smallest_drop: (drops & 2 == 2).then_some(3),
    };
    let room = TriangleSpace { bytes: u64::MAX, folder: &std::env::temp_dir() };
    let simplified = simplify(surface(), &reduction, 1.0, room, &Control::default()).unwrap();
    let mesh = collected(&simplified);
    assert_watertight(&mesh, "simplified");
    assert!(mesh.triangles.len() <= whole.triangles.len());
    if reduction.smallest_component.is_none()
        && reduction.smallest_drop.is_none()
        && !mesh.triangles.is_empty()
    {
        let [a, b] = [&whole, &mesh].map(measure);
        assert_eq!(
            (a.components, a.genus),
            (b.components, b.genus),
            "simplification changes the topology"
        );
        let found = compare(&whole, &mesh).unwrap();
        assert!(found.hausdorff <= tolerance, "the distance exceeds {tolerance}: {found:?}");
    }
}

fn assert_watertight(mesh: &Mesh, what: &str) {
    let report = check(mesh);
    assert!(mesh.triangles.is_empty() || report.is_closed_oriented_manifold(), "{what}: {report}");
}

fn surface_of(lowest: IVec3, iso: Isovalue, sample: impl Fn(IVec3) -> u16) -> StitchedSurface {
    let bins = CellBox {
        lo: lowest.div_euclid(IVec3::splat(BIN)),
        hi: (lowest + EDGE - 1).div_euclid(IVec3::splat(BIN)) + 1,
    };
    let page = |bin: IVec3| {
        let dense: Vec<u16> = CellBox::cube(bin, BIN).cubes(1).map(&sample).collect();
        PageInfo::from_dense(bin, &dense, BrickSide::Sixteen.into())
    };
    let mut pages: Vec<_> = bins.cubes(1).filter_map(page).collect();
    pages.sort_unstable_by_key(|(info, _)| info.key);
    let dif = DifField::in_memory(BrickSide::Sixteen.into(), pages);
    // Use a Gaussian so narrow that it does not change the samples.
    let filters =
        PaperFilters::new(IndicatorKind::Symmetry, Sigma::new(0.01).unwrap(), Detail::Smoothed);
    let recipe = Recipe::of_paper(filters, iso);
    let grid = Grid::new(DVec3::ZERO, 1.0).unwrap();
    let facts =
        FrameFacts { grid, domain: None, periodic: None, census: Census::default(), spacing: None };
    let sampled = SampledDif::new(facts, Indicator::Symmetry, dif);
    let surfaces = Surfaces {
        sampled: &sampled,
        recipe: &recipe,
        solid: None,
        normals: Normals::None,
        periodic_mesh: PeriodicMesh::Cut,
    };
    let stages = Cpu.start(MemoryBudget(8 << 30));
    let mut spool = Spool::in_memory(false, Vec::new());
    let mut push = |meshes: Vec<Option<BlockMesh>>| {
        meshes.into_iter().flatten().try_for_each(|mesh| spool.push(mesh))
    };
    let control = Control::default();
    stages
        .contour(&surfaces, &surfaces.regions(), &control.meter(Stage::Meshing, 1), &mut push)
        .unwrap();
    StitchedSurface::new(spool, grid, None, iso, Vec::new())
}

fn collected(source: &dyn MeshSource) -> Mesh {
    let mut mesh = Mesh::default();
    for piece in 0..source.pieces() {
        mesh.positions.extend_from_slice(&source.vertices(piece).unwrap().positions);
        let triangles = source.triangles(piece).unwrap();
        mesh.triangles.extend(triangles.into_iter().map(|t| t.map(|v| u32::try_from(v).unwrap())));
    }
    mesh
}
