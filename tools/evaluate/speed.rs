//! Measures the seconds per frame from particles in memory to a mesh in memory, for frames as large
//! as the paper's scenes (its table 1).

use std::time::Instant;

use meniscus::internals::frame::Normals;
use meniscus::internals::surface::stitch::StitchedSurface;
use meniscus::internals::system::timings::Timings;
use rayon::{ThreadPool, ThreadPoolBuilder};

use crate::methods::{Iso, Method, grid, volume_ratio};
use crate::scene::splash;
use crate::tables::{Table, deviation, mean};
use crate::{Options, Outcome};

/// The size of one of the paper's scenes, and the paper's times on one core for Mueller,
/// Zhu-Bridson, Yu-Turk, counting and symmetry.
struct PaperScene {
    name: &'static str,
    particles: f64,
    cells: u32,
    sigma: f64,
    seconds: [f64; 5],
}

const fn scene(
    name: &'static str,
    particles: f64,
    cells: u32,
    sigma: f64,
    seconds: [f64; 5],
) -> PaperScene {
    PaperScene { name, particles, cells, sigma, seconds }
}

const PAPER: [PaperScene; 4] = [
    scene("toy dragon", 1.20e6, 256, 1.0, [22.42, 15.94, 85.03, 7.30, 7.59]),
    scene("floating ball", 0.93e6, 256, 1.0, [18.85, 16.23, 100.05, 7.21, 8.63]),
    scene("double dam break", 1.00e6, 256, 1.0, [19.48, 14.05, 76.27, 6.74, 6.81]),
    scene("spaceship", 4.76e6, 384, 0.8, [129.78, 60.54, 899.84, 29.74, 34.16]),
];

/// A method that takes more seconds per frame than this is measured on only one frame.
const SLOW_SECONDS: f64 = 10.0;

impl PaperScene {
    /// The default method, and the paper's five methods with the paper's times. The isovalue is
    /// measured on the plateau. The paper's isovalues would lose most of the fluid, because here
    /// cells have fewer particles than in the paper's scenes.
    fn methods(&self) -> [(String, Method, Option<f64>); 6] {
        let &Self { sigma, seconds: [mueller, zhu_bridson, yu_turk, counting, symmetry], .. } =
            self;
        let paper = [
            (Method::counting(sigma, Iso::Auto), counting),
            (Method::symmetry(sigma, Iso::Auto), symmetry),
            (Method::MUELLER, mueller),
            (Method::ZHU_BRIDSON, zhu_bridson),
            (Method::YU_TURK, yu_turk),
        ];
        let ours = [("our defaults".into(), Method::CLOUD, None)];
        let mut all =
            ours.into_iter().chain(paper.map(|(method, s)| (method.name(), method, Some(s))));
        std::array::from_fn(|_| all.next().expect("six"))
    }
}

pub fn run(options: &Options) -> Outcome<()> {
    let cores = rayon::current_num_threads();
    let mut table = Table::new(&[
        "size of",
        "M particles",
        "cells",
        "threads",
        "method",
        "seconds",
        "deviation",
        "volume",
        "paper",
        "paper / here",
        "here / defaults",
    ]);
    let frames = options.choose(5, 2);
    for scene in &PAPER {
        let cells = options.choose(scene.cells, 64);
        let particles = scene.particles * options.choose(1.0, 0.02);
        let frames: Vec<_> = (0..frames).map(|seed| splash(particles as usize, seed)).collect();
        for threads in [1, cores] {
            let pool = ThreadPoolBuilder::new().num_threads(threads).build()?;
            let mut ours = None;
            for (name, method, paper) in scene.methods() {
                let (seconds, volume) = seconds(&method, &frames, cells, &pool)?;
                let mean = mean(seconds.iter().copied());
                let ours = *ours.get_or_insert(mean);
                // Show the paper's times only for one thread and all particles, as in the paper.
                let paper = paper.filter(|_| threads == 1 && !options.quick);
                table.row([
                    scene.name.into(),
                    format!("{:.2}", frames[0].len() as f64 / 1e6),
                    format!("{cells}^3"),
                    threads.to_string(),
                    name,
                    format!("{mean:.3}"),
                    format!("{:.3}", deviation(&seconds)),
                    format!("{volume:.2}"),
                    paper.map_or("-".into(), |paper| format!("{paper:.2}")),
                    paper.map_or("-".into(), |paper| format!("{:.1}", paper / mean)),
                    format!("{:.1}", mean / ours),
                ]);
            }
        }
    }
    table.print(
        "seconds per frame, from particles in memory to a mesh in memory: mean and standard \
         deviation over frames of a splash with this number of cells along its longest side; \
         volume: the mesh's, divided by the particles'; paper: the paper's seconds for its own \
         scenes, on one core of a Ryzen 9 3950X",
    );
    Ok(())
}

/// The time of each frame, in seconds, and the volume inside the last surface divided by the volume
/// of the particles. The first frame runs twice, and its first run does not count.
fn seconds(
    method: &Method,
    frames: &[Vec<[f32; 3]>],
    cells: u32,
    pool: &ThreadPool,
) -> Outcome<(Vec<f64>, f64)> {
    let (mut seconds, mut share) = (Vec::new(), f64::NAN);
    for frame in frames.iter().take(1).chain(frames) {
        let (cell, spacing) = (longest_side(frame) / f64::from(cells), 1.0);
        let start = Instant::now();
        let surface = pool.install(|| -> Outcome<StitchedSurface> {
            let timings = &mut Timings::default();
            let surface =
                method.surface(&frame[..], grid(cell)?, spacing, Normals::None, timings)?;
            std::hint::black_box(surface.to_mesh()?);
            Ok(surface)
        })?;
        seconds.push(start.elapsed().as_secs_f64());
        share = volume_ratio(&surface, frame.len(), spacing)?;
        if seconds[0] > SLOW_SECONDS {
            return Ok((seconds, share));
        }
    }
    Ok((seconds.split_off(1), share))
}

/// The largest coordinate, which is the longest side of a scene that begins at the origin.
pub fn longest_side(particles: &[[f32; 3]]) -> f64 {
    particles.iter().flatten().fold(0.0_f32, |longest, &x| longest.max(x)).into()
}
