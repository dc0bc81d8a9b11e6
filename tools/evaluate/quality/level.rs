//! Compares methods on pools: how flat the surface of a level pool is, and how much of the waves'
//! amplitude remains.

use std::f64::consts::TAU;

use glam::{DVec2, DVec3, IVec3};

use super::bodies::JITTER;
use super::components::{Count, components};
use super::heights::{Columns, Top};
use super::lines::{Board, Line, Lost, Points, cell_name};
use crate::sample::{cuboid, unit_cube_point};
use crate::scene::Random;
use crate::tables::{figure, mean, signed};
use crate::{Options, Outcome};

/// Edge length of the pools, in spacings.
const WIDTH: i32 = 48;
/// Depth of the pools, in spacings.
const DEPTH: i32 = 12;
/// Measurements ignore the parts of the pools within this distance of the edges.
const MARGIN: f64 = 12.0;
/// Wavelength and amplitude of each kind of wave, in spacings.
const WAVES: [[f64; 2]; 2] = [[5.0, 0.7], [8.0, 1.0]];

fn pool(jitter: f64, seed: usize, top: i32) -> Points {
    let mut random = Random::new(seed as u64);
    let pool = cuboid(IVec3::new(0, -DEPTH, 0), IVec3::new(WIDTH, top, WIDTH), jitter, &mut random);
    pool.into_iter().map(|p| (DVec3::from(p) + height(seed) * DVec3::Y).into()).collect()
}

/// The height of a pool's top. Each seed gives a different position within a cell.
fn height(seed: usize) -> f64 {
    unit_cube_point(seed).y
}

/// A grid over the middle of a pool, which is `along` spacings long in the x direction.
fn middle(along: f64) -> Columns {
    Columns::over(DVec2::splat(MARGIN), DVec2::new(MARGIN + along, f64::from(WIDTH) - MARGIN))
}

pub fn run(options: &Options, board: &Board) -> Outcome<()> {
    let seeds = options.choose(0..3_usize, 0..1);
    let mut lines = Vec::new();
    for cell in options.choose(vec![None, Some(0.5), Some(0.25)], vec![None]) {
        for jitter in [JITTER, 0.5] {
            let row = |what: &str| format!("jittered by {jitter}, {}: {what}", cell_name(cell));
            lines.push(Line {
                rows: ["bias", "RMS", "slope in degrees", "bubbles"].map(row).into(),
                cell,
                scenes: seeds.clone().map(|seed| pool(jitter, seed, 0).into()).collect(),
                lost: Lost::Row,
                read: Box::new(|meshes| {
                    let columns = middle(f64::from(WIDTH) - 2.0 * MARGIN);
                    let of = meshes.iter().enumerate().map(|(seed, mesh)| {
                        let tops: Vec<Top> = columns.tops(mesh).into_iter().flatten().collect();
                        deviation(&tops, height(seed))
                    });
                    let of: Vec<[f64; 3]> = of.collect();
                    let [bias, rms, slope] =
                        [0, 1, 2].map(|n| mean(of.iter().map(|figures| figures[n])));
                    let bubbles: usize =
                        meshes.iter().map(|mesh| Count::of(&components(mesh).0).bubbles).sum();
                    Ok(vec![signed(bias), figure(rms), format!("{slope:.2}"), bubbles.to_string()])
                }),
            });
        }
    }
    board.table("level pools: mean of 3, total number of bubbles", lines)?;

    let lines = WAVES.map(|[length, amplitude]| Line {
        rows: vec![format!("length {length}, amplitude {amplitude}")],
        cell: None,
        scenes: seeds.clone().map(|seed| wavy(length, amplitude, seed).into()).collect(),
        lost: Lost::Row,
        read: Box::new(move |meshes| {
            let columns = middle((2.0 * MARGIN / length).floor() * length);
            let kept = meshes.iter().map(|mesh| {
                let tops = columns.tops(mesh);
                let heights = tops
                    .iter()
                    .enumerate()
                    .filter_map(|(n, top)| Some((columns.point(n), (*top)?.height)));
                2.0 * mean(heights.map(|(at, height)| height * (TAU * at.x / length).sin()))
                    / amplitude
            });
            Ok(vec![figure(mean(kept))])
        }),
    });
    board.table(
        "waves jittered by 0.3: share of the amplitude that is kept, mean of 3",
        lines.into(),
    )
}

/// The mean error of the height, the RMS deviation from this mean, and the RMS slope, in degrees.
pub fn deviation(tops: &[Top], truth: f64) -> [f64; 3] {
    let bias = mean(tops.iter().map(|top| top.height)) - truth;
    let rms = mean(tops.iter().map(|top| (top.height - truth - bias).powi(2))).sqrt();
    [bias, rms, mean(tops.iter().map(|top| top.slope.powi(2))).sqrt().to_degrees()]
}

fn wavy(length: f64, amplitude: f64, seed: usize) -> Points {
    let below = |p: &[f64; 3]| p[1] - height(seed) < amplitude * (TAU * p[0] / length).sin();
    pool(JITTER, seed, amplitude.ceil() as i32 + 1).into_iter().filter(below).collect()
}
