//! Compares methods on frames of simulations: the roughness of calm water, the number of
//! components, and the volume.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use glam::{DVec2, DVec3, IVec2};
use meniscus::internals::field::spacing::estimate;
use meniscus::internals::io::bytes::Unpacking;
use meniscus::internals::io::input::{is_known, open_particles};
use meniscus::internals::io::scene::spacing_from_scene;
use meniscus::internals::particles::{Particles, velocity_attribute};
use meniscus::internals::surface::mesh::Mesh;

use super::clumps::CELLS;
use super::components::{Count, components};
use super::heights::Columns;
use super::lines::{Board, Line, Lost, Points, cell_name};
use crate::tables::{figure, mean};
use crate::{Options, Outcome};

/// The numbers of the frames of the repository's dam break.
const DAM_BREAK: [&str; 3] = ["1", "10", "20"];
/// Standard deviation, in spacings, of the Gaussian that separates roughness from wider features of
/// the surface.
const SIGMA: f64 = 3.0;
/// Edge, in spacings, of the square cells in which particles are examined for calm water.
const EDGE: f64 = 2.0;
/// Number of neighbouring cells on either side that must also be calm.
const REACH: i32 = 1;
/// Water is calm if the RMS distance of its top particles from a plane is less than this number of
/// spacings.
const CALM: f64 = 0.4;
/// Minimum depth of calm water, in spacings.
const DEPTH: f64 = 4.0;
/// Minimum share of [`DEPTH`] that particles fill in calm water.
const FULL: f64 = 0.5;

/// A frame of a simulation, scaled to spacing 1, with y up.
pub struct Frame {
    pub name: String,
    pub points: Points,
    /// The direction of each particle's velocity, a vector of length 1 or 0; empty if unknown.
    pub directions: Vec<DVec3>,
}

impl Frame {
    pub fn read(path: &Path, name: String) -> Outcome<Self> {
        let file = open_particles(path, Unpacking::in_memory())?;
        let particles = &file.particles;
        let known = file
            .spacing
            .or_else(|| Some(spacing_from_scene(path)?.0))
            .or_else(|| estimate(particles));
        let spacing =
            known.ok_or_else(|| format!("{}: the spacing is not known", path.display()))?;
        let mut points = vec![[0.0; 3]; particles.len()];
        particles.positions(0, &mut points);
        points.iter_mut().flatten().for_each(|x| *x /= spacing);
        let mut directions = Vec::new();
        if let Some(velocity) = velocity_attribute(particles.attributes()) {
            let mut velocities = vec![[0.0_f32; 3]; points.len()];
            particles.attribute(velocity, 0, velocities.as_flattened_mut());
            directions = velocities
                .iter()
                .map(|v| DVec3::from(v.map(f64::from)).normalize_or_zero())
                .collect();
        }
        Ok(Self { name, points, directions })
    }

    /// Reads the middle frame of a folder, in file name order.
    pub fn middle_of(folder: &Path) -> Outcome<Self> {
        let entries: Vec<_> = std::fs::read_dir(folder)?.collect::<Result<_, _>>()?;
        let mut files: Vec<PathBuf> = entries.into_iter().map(|entry| entry.path()).collect();
        files.retain(|path| path.is_file() && is_known(path));
        files.sort();
        let path =
            files.get(files.len() / 2).ok_or_else(|| format!("{}: no frames", folder.display()))?;
        let [folder, file] = [folder.file_name(), path.file_stem()]
            .map(|name| name.unwrap_or_default().to_string_lossy().into_owned());
        Self::read(path, format!("{folder} {file}"))
    }

    /// A horizontal grid of points over the frame, and for each point whether the water is calm.
    fn calm(&self) -> (Columns, Vec<bool>) {
        let flat = |p: &[f64; 3]| DVec2::new(p[0], p[2]);
        let (lo, hi) = self
            .points
            .iter()
            .map(flat)
            .fold((DVec2::INFINITY, DVec2::NEG_INFINITY), |(lo, hi), p| (lo.min(p), hi.max(p)));
        let columns = Columns::over(lo, hi);
        let cell = |at: DVec2| (at / EDGE).floor().as_ivec2();
        let mut heights: HashMap<IVec2, Vec<f64>> = HashMap::new();
        for p in &self.points {
            heights.entry(cell(flat(p))).or_default().push(p[1]);
        }
        let tops: HashMap<IVec2, f64> = heights
            .iter()
            .filter_map(|(&cell, heights)| {
                let top = heights.iter().copied().fold(f64::NEG_INFINITY, f64::max);
                let below = heights.iter().filter(|&&height| height > top - DEPTH).count() as f64;
                (below > FULL * DEPTH * EDGE * EDGE).then_some((cell, top))
            })
            .collect();
        let calm: HashMap<IVec2, bool> =
            tops.keys().map(|&cell| (cell, is_calm(&tops, cell))).collect();
        let of = |point: usize| calm.get(&cell(columns.point(point))).copied().unwrap_or(false);
        let mask = (0..columns.count()).map(of).collect();
        (columns, mask)
    }
}

/// Whether all cells around a cell contain water, and the top of this water is nearly a plane.
fn is_calm(tops: &HashMap<IVec2, f64>, cell: IVec2) -> bool {
    let range = || -REACH..=REACH;
    let offs = range().flat_map(|x| range().map(move |y| IVec2::new(x, y)));
    let around: Option<Vec<(DVec2, f64)>> =
        offs.map(|off| Some((off.as_dvec2(), *tops.get(&(cell + off))?))).collect();
    let Some(around) = around else { return false };
    let middle = mean(around.iter().map(|(_, top)| *top));
    // The offsets are symmetric, so the slopes along x and z are independent.
    let slope: DVec2 = around.iter().map(|(off, top)| *off * (top - middle)).sum::<DVec2>()
        / around.iter().map(|(off, _)| off.x * off.x).sum::<f64>();
    mean(around.iter().map(|(off, top)| (top - middle - slope.dot(*off)).powi(2))).sqrt() < CALM
}

/// Reads the frames of the repository's dam break.
pub fn dam_break() -> Outcome<Vec<Frame>> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/dambreak_small");
    let read = |number: &str| {
        Frame::read(
            &folder.join(format!("ParticleData_Fluid_{number}.bgeo")),
            format!("dam break {number}"),
        )
    };
    DAM_BREAK.into_iter().map(read).collect()
}

pub fn run(options: &Options, board: &Board, dam: &[Frame], given: &[Frame]) -> Outcome<()> {
    let mut lines = Vec::new();
    for frame in dam.iter().skip(1).chain(given) {
        let (columns, calm) = frame.calm();
        let count = frame.points.len();
        let area = calm.iter().filter(|&&calm| calm).count() / 4;
        lines.push(Line {
            rows: vec![
                format!("{}: RMS roughness of {area} square spacings of calm water", frame.name),
                format!("{}: RMS slope of the roughness, in degrees", frame.name),
                format!("{}: components, bubbles", frame.name),
                format!("{}: volume relative to the particles'", frame.name),
            ],
            cell: None,
            scenes: vec![frame.points.clone().into()],
            lost: Lost::Row,
            read: Box::new(move |meshes| {
                let all = Count::of(&components(&meshes[0]).0);
                let [height, slope] = roughness(&columns, &calm, &meshes[0]);
                let volume = figure(all.volume / count as f64);
                Ok(vec![figure(height), format!("{slope:.2}"), all.text(), volume])
            }),
        });
    }
    board.table(
        "water of simulations: roughness is relative to heights smoothed by a Gaussian of 3 \
         spacings",
        lines,
    )?;

    let mut lines = Vec::new();
    if let Some(last) = dam.last() {
        for &cell in options.choose(&CELLS[..], &CELLS[2..3]) {
            lines.push(Line {
                rows: vec![format!(
                    "{}, {}: components, bubbles",
                    last.name,
                    cell_name(Some(cell))
                )],
                cell: Some(cell),
                scenes: vec![last.points.clone().into()],
                lost: Lost::Row,
                read: Box::new(|meshes| Ok(vec![Count::of(&components(&meshes[0]).0).text()])),
            });
        }
    }
    let counts: Vec<f64> = dam.iter().map(|frame| frame.points.len() as f64).collect();
    lines.push(Line {
        rows: vec![format!(
            "least and greatest volume relative to the particles', frames {}",
            DAM_BREAK.join(", ")
        )],
        cell: None,
        scenes: dam.iter().map(|frame| frame.points.clone().into()).collect(),
        lost: Lost::Row,
        read: Box::new(move |meshes| {
            let volumes = meshes
                .iter()
                .zip(&counts)
                .map(|(mesh, count)| Count::of(&components(mesh).0).volume / count);
            let (least, greatest) = volumes.fold((f64::INFINITY, 0.0_f64), |(lo, hi), volume| {
                (lo.min(volume), hi.max(volume))
            });
            Ok(vec![format!("{least:.3}, {greatest:.3}")])
        }),
    });
    board.table("the dam break with several cell sizes", lines)
}

/// The roughness of calm water: the RMS of its heights after subtracting their Gaussian mean, and
/// the RMS of the remaining slope, in degrees.
fn roughness(columns: &Columns, calm: &[bool], mesh: &Mesh) -> [f64; 2] {
    let tops = columns.tops(mesh).into_iter().zip(calm);
    let heights: Vec<Option<f64>> =
        tops.map(|(top, &calm)| top.filter(|_| calm).map(|top| top.height)).collect();
    let left = columns.without_gaussian(&heights, SIGMA);
    let rms = |squares: Vec<f64>| mean(squares).sqrt();
    let slopes = (0..left.len()).filter_map(|n| {
        let row = n % columns.size[0];
        let [x, z] = [(row + 1 < columns.size[0]).then_some(1), Some(columns.size[0])]
            .map(|step| Some(columns.per_step(left[n]?, (*left.get(n + step?)?)?)));
        Some(x?.powi(2) + z?.powi(2))
    });
    let slope = rms(slopes.collect()).atan().to_degrees();
    [rms(left.iter().flatten().map(|height| height.powi(2)).collect()), slope]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample::cuboid;
    use crate::scene::Random;
    use glam::IVec3;

    #[test]
    fn a_pool_is_calm_except_at_its_edges_and_below_a_drop() {
        let mut points = cuboid(IVec3::ZERO, IVec3::new(60, 8, 40), 0.3, &mut Random::new(1));
        points.push([45.0, 20.0, 20.0]);
        let frame = Frame { name: String::new(), points, directions: Vec::new() };
        let (columns, calm) = frame.calm();
        let at = |x: f64, z: f64| calm[columns.nearest(DVec2::new(x, z)).unwrap()];
        assert!(at(15.0, 20.0) && at(30.0, 10.0));
        assert!(!at(45.0, 20.0) && !at(1.0, 20.0));
    }
}
