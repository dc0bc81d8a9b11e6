//! Measures the surface around a ball that moves through a pool: its distance from the ball, and
//! its changes from frame to frame near the contact line.
//!
//! The particles move on the streamlines of a potential flow around the ball. If the vertices of a
//! frame move with this flow, they should therefore lie on the surface of the next frame. For
//! comparison, the changes are also measured with water, and with a hole, in place of the ball.

use std::fmt::Write;
use std::fs;
use std::path::Path;

use glam::{DVec3, IVec3};
use meniscus::Reconstruction;
use meniscus::internals::surface::mesh::Mesh;
use meniscus::internals::surface::mesh::compare::SearchableSurface;
use rayon::prelude::*;
use tempfile::TempDir;

use crate::meshes::{moved, sphere};
use crate::sample::cuboid;
use crate::scene::Random;
use crate::tables::{Table, figure, mean, signed, worst};
use crate::{Options, Outcome};

/// The size of the pool, in spacings. The pool's surface is at y = 0.
const SIZE: IVec3 = IVec3::new(44, 12, 34);
const RADIUS: f64 = 6.0;
/// The centre of the ball in the first frame.
const START: DVec3 = DVec3::new(17.0, -2.0, 17.0);
/// The movement of the ball per frame.
const MOVE: DVec3 = DVec3::new(0.5, 0.0, 0.0);
const FRAMES: usize = 20;
/// Number of integration steps of a particle's movement per frame.
const STEPS: usize = 8;
/// Smallest and largest distance, in spacings, between the ball and vertices near the contact line.
const NEAR: [f64; 2] = [0.3, 4.0];
/// The pool's surface sinks behind the ball. Vertices below this height do not belong to the
/// surface.
const DEEP: f64 = -4.0;

pub fn run(options: &Options) -> Outcome<()> {
    let mut table = Table::new(&[
        "cell / spacing",
        "jitter",
        "to the ball: bias",
        "RMS",
        "greatest",
        "change near",
        "with a ball of water",
        "with a hole",
    ]);
    let folder = TempDir::new()?;
    for &cell in options.choose(&[0.25, 0.5][..], &[0.5]) {
        for jitter in [0.3, 0.5] {
            let all = frames(jitter, options.choose(FRAMES, 3));
            let outside: Vec<_> = all.iter().map(|frame| outside(frame, &all[0])).collect();
            let of_solid = surfaces(&outside, cell, Some(folder.path()))?;
            let to_ball: Vec<f64> = (0..)
                .zip(&of_solid)
                .flat_map(|(number, mesh)| {
                    let distances =
                        mesh.positions.iter().map(|&p| (p, from_ball(p.into(), number)));
                    let at_ball = distances.filter(|&(p, d)| d.abs() < 1.5 && p[1] < DEEP);
                    at_ball.map(|(_, distance)| distance).collect::<Vec<_>>()
                })
                .collect();
            let bias = mean(to_ball.iter().copied());
            let rms = mean(to_ball.iter().map(|d| d * d)).sqrt();
            table.row([
                figure(cell),
                figure(jitter),
                signed(bias),
                figure(rms),
                figure(worst(to_ball).abs()),
                figure(change(&of_solid)?),
                figure(change(&surfaces(&all, cell, None)?)?),
                figure(change(&surfaces(&outside, cell, None)?)?),
            ]);
        }
    }
    table.print(&format!(
        "a ball moves through a pool in {FRAMES} frames: its distance from the fluid; and the RMS \
         distance between the surface, moved with the flow, and the surface of the next frame, {} \
         to {} spacings from the ball",
        NEAR[0], NEAR[1]
    ));
    Ok(())
}

fn centre(frame: usize) -> DVec3 {
    START + frame as f64 * MOVE
}

fn from_ball(at: DVec3, frame: usize) -> f64 {
    at.distance(centre(frame)) - RADIUS
}

/// The velocity of the fluid around a moving ball, in distance per frame. This is the ideal flow
/// around a ball (a dipole).
fn velocity(at: DVec3, ball: DVec3) -> DVec3 {
    let away = at - ball;
    let distance = away.length().max(RADIUS);
    let way = away / distance;
    (RADIUS / distance).powi(3) * (3.0 * MOVE.dot(way) * way - MOVE) / 2.0
}

/// A particle's position one frame later, by the midpoint method. Points inside the ball move with
/// the ball.
fn after(mut at: DVec3, frame: usize) -> DVec3 {
    if from_ball(at, frame) < 0.0 {
        return at + MOVE;
    }
    let share = 1.0 / STEPS as f64;
    for step in 0..STEPS {
        let ball = centre(frame) + MOVE * (step as f64 * share);
        let half = at + velocity(at, ball) * share / 2.0;
        at += velocity(half, ball + MOVE * share / 2.0) * share;
    }
    at
}

/// The particles of a frame that were outside the ball in the first frame.
fn outside(frame: &[[f64; 3]], first: &[[f64; 3]]) -> Vec<[f64; 3]> {
    let both = frame.iter().zip(first);
    both.filter(|(_, first)| from_ball(DVec3::from(**first), 0) > 0.0).map(|(&p, _)| p).collect()
}

/// The particles of each frame, including particles inside the ball.
fn frames(jitter: f64, count: usize) -> Vec<Vec<[f64; 3]>> {
    let lo = IVec3::new(0, -SIZE.y, 0);
    let first = cuboid(lo, IVec3::new(SIZE.x, 0, SIZE.z), jitter, &mut Random::new(7));
    let next = |particles: &Vec<[f64; 3]>, frame: usize| {
        particles.iter().map(|&p| after(p.into(), frame).to_array()).collect()
    };
    (1..count).fold(vec![first], |mut frames, frame| {
        frames.push(next(&frames[frame - 1], frame - 1));
        frames
    })
}

/// Reconstructs the surfaces of all frames. If `folder` is given, the ball is a solid, and its
/// meshes are written into the folder.
fn surfaces(frames: &[Vec<[f64; 3]>], cell: f64, folder: Option<&Path>) -> Outcome<Vec<Mesh>> {
    let surface = |(frame, particles): (usize, &Vec<[f64; 3]>)| -> Outcome<Mesh> {
        let mut request = Reconstruction::new().spacing(1.0).cell(cell).threads(1);
        if let Some(folder) = folder {
            let ball = moved(&sphere(RADIUS, 5), centre(frame).to_array());
            let file = folder.join(format!("ball_{frame}.obj"));
            fs::write(&file, to_obj(&ball))?;
            request = request.solids([file.to_string_lossy()]).solid_offset(0.0);
        }
        Ok(request.run(&particles[..])?.to_mesh()?)
    };
    frames.par_iter().enumerate().map(surface).collect()
}

fn to_obj(mesh: &Mesh) -> String {
    let mut text = String::new();
    for [x, y, z] in &mesh.positions {
        let _ = writeln!(text, "v {x} {y} {z}");
    }
    for [a, b, c] in mesh.triangles.iter().map(|triangle| triangle.map(|vertex| vertex + 1)) {
        let _ = writeln!(text, "f {a} {b} {c}");
    }
    text
}

/// Moves the vertices near the contact line to the next frame, and returns their RMS distance from
/// the next frame's surface.
fn change(meshes: &[Mesh]) -> Outcome<f64> {
    let [least, most] = NEAR;
    let squares = |(frame, pair): (usize, &[Mesh])| -> Outcome<Vec<f64>> {
        let is_level = |p: &DVec3| {
            let inner = (6.0..f64::from(SIZE.x) - 6.0).contains(&p.x)
                && (6.0..f64::from(SIZE.z) - 6.0).contains(&p.z);
            inner && p.y > DEEP && (least..most).contains(&from_ball(*p, frame))
        };
        let places = pair[0].positions.iter().map(|&p| DVec3::from(p)).filter(is_level);
        let carried: Vec<[f64; 3]> = places.map(|p| after(p, frame).to_array()).collect();
        let next = SearchableSurface::reference(&pair[1])?;
        Ok(next.signed_distances(&carried).into_iter().map(|distance| distance.powi(2)).collect())
    };
    let squares: Vec<Vec<f64>> =
        meshes.par_windows(2).enumerate().map(squares).collect::<Outcome<_>>()?;
    Ok(mean(squares.into_iter().flatten()).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_fluid_flows_around_the_ball_and_not_into_it() {
        let ball = centre(0);
        let on = |way: DVec3| (velocity(ball + RADIUS * way, ball) - MOVE).dot(way);
        for way in [DVec3::X, DVec3::Y, DVec3::new(0.6, 0.0, -0.8)] {
            assert!(on(way).abs() < 1e-12, "{way}");
        }
        let frames = frames(0.3, 3);
        for (number, particles) in frames.iter().enumerate() {
            let particles = outside(particles, &frames[0]);
            let nearest = particles.iter().map(|&p| from_ball(p.into(), number));
            assert!(nearest.fold(f64::MAX, f64::min) > -1e-3);
        }
    }
}
