//! Seconds a frame from particles in memory to a mesh in memory, at the sizes of the paper's scenes (its table 1).

use std::time::Instant;

use meniscus::frame::Normals;
use meniscus::laps::Laps;
use rayon::{ThreadPool, ThreadPoolBuilder};

use crate::methods::{Iso, Method, grid};
use crate::scene::splash;
use crate::tables::{Table, deviation, mean};
use crate::{Options, Outcome};

/// One of the paper's scenes: what it took on one core.
struct PaperScene {
    name: &'static str,
    particles: f64,
    cells: u32,
    sigma: f64,
    iso: f64,
    counting: f64,
    symmetry: f64,
}

const PAPER: [PaperScene; 4] = [
    PaperScene {
        name: "toy dragon",
        particles: 1.20e6,
        cells: 256,
        sigma: 1.0,
        iso: 0.05,
        counting: 7.30,
        symmetry: 7.59,
    },
    PaperScene {
        name: "floating ball",
        particles: 0.93e6,
        cells: 256,
        sigma: 1.0,
        iso: 0.1,
        counting: 7.21,
        symmetry: 8.63,
    },
    PaperScene {
        name: "double dam break",
        particles: 1.0e6,
        cells: 256,
        sigma: 1.0,
        iso: 0.1,
        counting: 6.74,
        symmetry: 6.81,
    },
    PaperScene {
        name: "spaceship",
        particles: 4.76e6,
        cells: 384,
        sigma: 0.8,
        iso: 0.05,
        counting: 29.74,
        symmetry: 34.16,
    },
];

/// A method that takes longer a frame is measured on one frame only.
const PATIENCE: f64 = 10.0;

impl PaperScene {
    /// Methods, each with the paper's seconds; ours by default first.
    fn methods(&self) -> Vec<(String, Method, Option<f64>)> {
        let Self { sigma, iso, counting, symmetry, .. } = *self;
        vec![
            ("symmetry, our defaults".into(), Method::SYMMETRY, None),
            ("symmetry".into(), Method::symmetry(sigma, Iso::At(iso)), Some(symmetry)),
            ("counting".into(), Method::counting(sigma, Iso::At(iso)), Some(counting)),
        ]
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
        "paper",
        "paper / here",
        "here / defaults",
    ]);
    let frames = options.choose(5, 2);
    for scene in &PAPER {
        let particles = scene.particles * options.choose(1.0, 0.02);
        let frames: Vec<_> = (0..frames).map(|seed| splash(particles as usize, seed)).collect();
        for threads in [1, cores] {
            let pool = ThreadPoolBuilder::new().num_threads(threads).build()?;
            let mut ours = None;
            for (name, method, paper) in scene.methods() {
                let seconds = seconds(&method, &frames, options.choose(scene.cells, 64), &pool)?;
                let mean = mean(seconds.iter().copied());
                let ours = *ours.get_or_insert(mean);
                // The paper's figures are of one core.
                let paper = paper.filter(|_| threads == 1);
                table.row([
                    scene.name.into(),
                    format!("{:.2}", frames[0].len() as f64 / 1e6),
                    format!("{}^3", scene.cells),
                    threads.to_string(),
                    name,
                    format!("{mean:.3}"),
                    format!("{:.3}", deviation(&seconds)),
                    paper.map_or("-".into(), |paper| format!("{paper:.2}")),
                    paper.map_or("-".into(), |paper| format!("{:.1}", paper / mean)),
                    format!("{:.1}", mean / ours),
                ]);
            }
        }
    }
    table.print(
        "seconds a frame, particles in memory to mesh in memory, mean and deviation over frames of a splash \
         whose longest side has so many cells; the paper's are of one core of a Ryzen 9 3950X and its own scenes",
    );
    Ok(())
}

/// Seconds of each frame, after one that takes what the memory's first use takes.
fn seconds(method: &Method, frames: &[Vec<[f32; 3]>], cells: u32, pool: &ThreadPool) -> Outcome<Vec<f64>> {
    let mut seconds = Vec::new();
    for frame in frames.iter().take(1).chain(frames) {
        let (cell, spacing) = (longest_side(frame) / f64::from(cells), 1.0);
        let start = Instant::now();
        pool.install(|| -> Outcome<()> {
            let laps = &mut Laps::default();
            let surface = method.surface(&frame[..], grid(cell)?, spacing, Normals::None, laps)?;
            std::hint::black_box(surface.to_mesh()?);
            Ok(())
        })?;
        seconds.push(start.elapsed().as_secs_f64());
        if seconds[0] > PATIENCE {
            return Ok(seconds);
        }
    }
    Ok(seconds.split_off(1))
}

/// Of the box around particles that are not below 0.
pub fn longest_side(particles: &[[f32; 3]]) -> f64 {
    particles.iter().flatten().fold(0.0_f32, |longest, &x| longest.max(x)).into()
}
