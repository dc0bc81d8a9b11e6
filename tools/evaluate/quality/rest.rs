//! Compares methods by the stability of the surface from frame to frame, for a pool that rises by
//! one cell, and for flowing water.

use std::collections::HashMap;

use glam::{DVec2, DVec3, IVec3};
use meniscus::internals::surface::mesh::Mesh;
use meniscus::internals::surface::mesh::compare::compare;
use rayon::prelude::*;

use super::bodies::JITTER;
use super::frames::Frame;
use super::heights::Columns;
use super::lines::{Board, Line, Lost, Points, Scene};
use crate::sample::cuboid;
use crate::scene::Random;
use crate::tables::{figure, mean};
use crate::{Options, Outcome};

const CELL: f64 = 0.5;
/// Number of steps in which the pool rises by a cell.
const STEPS: usize = 8;
/// Number of steps of the flow.
const MOVES: usize = 3;
/// Distance, in spacings, that particles flow in one step.
const MOVE: f64 = 0.1;
/// Edge length of the pool, in spacings.
const WIDTH: i32 = 36;
/// Depth of the pool, in spacings.
const DEPTH: i32 = 12;
/// Measurements ignore the parts of the pool within this distance of the edges.
const MARGIN: f64 = 12.0;
/// A vertex moves with the particles that are within this distance of it.
const NEAR: f64 = 2.5;

pub fn run(options: &Options, board: &Board, dam: &[Frame]) -> Outcome<()> {
    let pools = [0.0, JITTER].map(|jitter| {
        let lo = IVec3::new(0, -DEPTH, 0);
        let pool = cuboid(lo, IVec3::new(WIDTH, 0, WIDTH), jitter, &mut Random::new(16));
        let raised = |step: usize| -> Points {
            pool.iter().map(|&[x, y, z]| [x, y + rise(step), z]).collect()
        };
        Line {
            rows: vec![format!("pool, jittered by {jitter}: largest movement in a step, in cells")],
            cell: Some(CELL),
            scenes: (0..=STEPS).map(|step| raised(step).into()).collect(),
            lost: Lost::Row,
            read: Box::new(|meshes| {
                let columns =
                    Columns::over(DVec2::splat(MARGIN), DVec2::splat(f64::from(WIDTH) - MARGIN));
                let height = |(step, mesh): (usize, &Mesh)| {
                    mean(columns.tops(mesh).iter().flatten().map(|top| top.height)) - rise(step)
                };
                let heights: Vec<f64> = meshes.iter().enumerate().map(height).collect();
                let moves = heights.windows(2).map(|pair| (pair[1] - pair[0]).abs());
                Ok(vec![figure(moves.fold(0.0, f64::max) / CELL)])
            }),
        }
    });
    let moving = dam.iter().skip(1).filter(|frame| !frame.directions.is_empty());
    let moving = moving.map(|frame| {
        let steps: Vec<Points> =
            (0..options.choose(MOVES, 1) + 1).map(|step| frame.after(step)).collect();
        let (scenes, directions) = (steps.clone(), frame.directions.clone());
        Line {
            rows: vec![format!(
                "{}: RMS distance from the moved surface to the next one",
                frame.name
            )],
            cell: Some(CELL),
            scenes: scenes.into_iter().map(Scene::from).collect(),
            lost: Lost::Row,
            read: Box::new(move |meshes| {
                let far = meshes.windows(2).zip(&steps).map(|(pair, points)| -> Outcome<f64> {
                    Ok(compare(&pair[1], &carried(&pair[0], points, &directions))?.from_mesh.rms)
                });
                Ok(vec![figure(mean(far.collect::<Outcome<Vec<f64>>>()?))])
            }),
        }
    });
    let lines = pools.into_iter().chain(moving).collect();
    board.table(
        "stability, with each frame reconstructed separately: a level pool that rises by a cell \
         in 8 steps, relative to the rise; and water whose particles move by 0.1 spacings per \
         step",
        lines,
    )
}

fn rise(step: usize) -> f64 {
    CELL * step as f64 / STEPS as f64
}

impl Frame {
    /// The particles after a number of steps.
    fn after(&self, step: usize) -> Points {
        let by = MOVE * step as f64;
        self.points
            .iter()
            .zip(&self.directions)
            .map(|(&p, &way)| (DVec3::from(p) + by * way).into())
            .collect()
    }
}

/// The mesh after a step: each vertex moves by the weighted mean movement of the particles around
/// it.
fn carried(mesh: &Mesh, points: &[[f64; 3]], directions: &[DVec3]) -> Mesh {
    let cell = |p: DVec3| (p / NEAR).floor().as_ivec3();
    let mut particles: HashMap<IVec3, Vec<usize>> = HashMap::new();
    for (n, &p) in points.iter().enumerate() {
        particles.entry(cell(p.into())).or_default().push(n);
    }
    let carry = |&position: &[f64; 3]| {
        let position = DVec3::from(position);
        let offs = (0..27).map(|n| IVec3::new(n % 3, n / 3 % 3, n / 9) - 1);
        let near = offs.filter_map(|off| particles.get(&(cell(position) + off))).flatten();
        let (way, weight) = near.fold((DVec3::ZERO, 0.0), |(way, sum), &n| {
            let share = DVec3::from(points[n]).distance_squared(position) / (NEAR * NEAR);
            let weight = (1.0 - share).max(0.0).powi(3);
            (way + weight * directions[n], sum + weight)
        });
        (if weight > 0.0 { position + MOVE / weight * way } else { position }).into()
    };
    Mesh {
        positions: mesh.positions.par_iter().map(carry).collect(),
        normals: None,
        ..mesh.clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::meshes::cuboid;

    #[test]
    fn vertices_move_with_the_particles_near_them() {
        let mesh = cuboid([0.0; 3], [20.0; 3]);
        let points = [[0.5; 3], [19.5; 3], [19.0; 3]];
        let moved = carried(&mesh, &points, &[DVec3::X, DVec3::Y, DVec3::Y]);
        assert_eq!([moved.positions[0], moved.positions[7]], [[0.1, 0.0, 0.0], [20.0, 20.1, 20.0]]);
        assert_eq!(moved.positions[1], mesh.positions[1]);
    }
}
