//! Measures the throughput of each stage and of a whole frame in memory, and the machine's memory
//! bandwidth.
//!
//! `cargo bench --bench stages [-- MILLIONS_OF_PARTICLES]`

mod scene;

use std::hint::black_box;
use std::time::Instant;

use glam::DVec3;
use meniscus::internals::backend::field;
use meniscus::internals::brick::{BinPlan, Block, BrickSide, CountingRoom, InvalidParticles};
use meniscus::internals::field::blur::{Weights, blur};
use meniscus::internals::field::indicator::{IndicatorKind, PageRule, indicate};
use meniscus::internals::frame::{Engine, Normals, Resources, Sampling, Surfacing};
use meniscus::internals::grid::units::{MemoryBudget, Sigma};
use meniscus::internals::grid::{CellBox, Grid};
use meniscus::internals::surface::dual_mc::contour;
use meniscus::internals::surface::mesh::source::MeshSource;
use meniscus::internals::surface::mesh::spool::Spool;
use meniscus::internals::surface::stitch::StitchedSurface;
use meniscus::internals::system::timings::Timings;
use rayon::prelude::*;

/// The time, in seconds, and the result of the fastest of `runs` runs. Other processes disturb the
/// fastest run least.
fn best_seconds<T>(runs: usize, mut work: impl FnMut() -> T) -> (f64, T) {
    let mut best: Option<(f64, T)> = None;
    for _ in 0..runs {
        let start = Instant::now();
        let result = black_box(work());
        let seconds = start.elapsed().as_secs_f64();
        if best.as_ref().is_none_or(|(b, _)| seconds < *b) {
            best = Some((seconds, result));
        }
    }
    best.expect("at least one run")
}

fn row(what: &str, amount: f64, unit: &str, seconds: f64) {
    println!("{what:<34} {:>9.1} {unit:<14} {:>9.1} ms", amount / seconds / 1e6, seconds * 1e3);
}

fn main() {
    let millions = std::env::args().skip(1).find_map(|a| a.parse::<f64>().ok()).unwrap_or(10.0);
    let particles = scene::splash((millions * 1e6) as usize, 1);
    let count = particles.len() as f64;
    println!(
        "{count} particles in random order, cell = spacing, {} threads",
        rayon::current_num_threads()
    );

    let from = vec![1_u8; 1 << 28];
    let mut to = vec![0_u8; 1 << 28];
    let (seconds, ()) = best_seconds(3, || {
        to.par_chunks_mut(1 << 20)
            .zip(from.par_chunks(1 << 20))
            .for_each(|(a, b)| a.copy_from_slice(b));
    });
    row("memory copy (read + write)", 2.0 * from.len() as f64, "MB/s", seconds);
    drop((from, to));

    let grid = Grid::new(DVec3::ZERO, 1.0).expect("a valid grid");
    let bin = || {
        BinPlan::count(&particles, &grid, None, InvalidParticles::Refuse, CountingRoom::BINS)
            .expect("valid particles")
            .fill(&particles, &[])
            .expect("the same particles")
    };
    let (bin_seconds, bins) = best_seconds(3, bin);
    row("bin", count, "M particles/s", bin_seconds);
    for kind in [IndicatorKind::Symmetry, IndicatorKind::Counting, IndicatorKind::Cloud] {
        let side = BrickSide::Eight;
        let rule = PageRule { indicator: kind, spacing_cells: 1.0, side, walls: None };
        let (seconds, _) = best_seconds(3, || indicate(&bins, 0..bins.keys().len(), &rule));
        let name = kind.name();
        row(&format!("accumulate, {name}"), count, "M particles/s", seconds);
        row(&format!("bin and accumulate, {name}"), count, "M particles/s", bin_seconds + seconds);
    }

    let weights = Weights::gaussian(Sigma::new(1.0).expect("a valid sigma"));
    let block = Block::<u16>::zero(
        CellBox::cube(glam::IVec3::ZERO, 33).grown(weights.reach(), weights.reach()),
    );
    let blocks = 4096;
    // Each blur gets its own copy of the block.
    let (seconds, _) = best_seconds(3, || {
        (0..blocks)
            .into_par_iter()
            .map(|_| blur(black_box(block.clone()), &weights, None).samples().len())
            .sum::<usize>()
    });
    row("blur, reach 2, blocks of 32^3", f64::from(blocks) * 32f64.powi(3), "M cells/s", seconds);
    drop(bins);

    let sampling = Sampling {
        grid,
        domain: None,
        periodic: None,
        method: IndicatorKind::Symmetry.into(),
        invalid: InvalidParticles::Refuse,
        side: BrickSide::Eight,
        carried: Vec::new(),
        kinds: Vec::new(),
        sizes: None,
        spacing: None,
        resources: Resources::new(MemoryBudget(u64::MAX), std::env::temp_dir()),
    };
    let surfacing = Surfacing::PLAIN;
    let frame = Engine::sample(&particles, &sampling, &mut Timings::default()).expect("a frame");
    let sampled = frame.dif().expect("an indicator makes the field");
    let measured = surfacing.calibrate(sampled).expect("cells of a spacing");
    let recipe = surfacing.recipe(sampled, &measured.calibration);
    let blocks = sampled.dif.regions(0, 0);
    let (halo, reach) = (2, recipe.filters.reach());
    let (seconds, samples) = best_seconds(3, || {
        let gathered = blocks.par_iter().map(|cells| sampled.dif.gather(cells.grown(halo, halo)));
        gathered.map(|block| block.samples().len()).sum::<usize>()
    });
    row("gather, halo 2, blocks of 32^3", samples as f64, "M cells/s", seconds);
    let fields: Vec<(CellBox, Block)> = sampled
        .dif
        .regions(reach + 1, reach)
        .into_par_iter()
        .map(|cells| (cells, field(&recipe, sampled, Normals::None.cells(cells))))
        .collect();
    let (seconds, mesh) = best_seconds(3, || {
        let surfaces: Vec<_> = fields
            .par_iter()
            .map(|(cells, field)| contour(field, *cells, recipe.iso, None))
            .collect();
        let mut spool = Spool::in_memory(false, Vec::new());
        surfaces
            .into_iter()
            .try_for_each(|surface| spool.push(surface))
            .expect("nothing is written");
        StitchedSurface::new(spool, grid, None, recipe.iso, Vec::new())
            .to_mesh()
            .expect("few enough vertices")
    });
    row("marching cubes and stitching", mesh.triangles.len() as f64, "M triangles/s", seconds);
    drop((frame, fields, mesh));

    let (seconds, (timings, surface)) = best_seconds(3, || {
        let mut timings = Timings::default();
        let frame = Engine::sample(&particles, &sampling, &mut timings).expect("a frame");
        let surface = frame.surface(&surfacing, &mut timings).expect("a surface");
        (timings, surface)
    });
    row("whole frame, before writing", count, "M particles/s", seconds);
    for (stage, seconds) in timings.seconds() {
        println!("  {stage:<32} {:>35.1} ms", seconds * 1e3);
    }
    println!("  {} vertices, {} triangles", surface.vertex_count(), surface.triangle_count());
}
