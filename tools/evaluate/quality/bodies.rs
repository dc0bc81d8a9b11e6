//! Compares methods on bodies filled with particles: the distances between the surfaces and the
//! bodies, and the enclosed volumes.

use std::collections::HashSet;
use std::path::PathBuf;

use glam::{DQuat, DVec3, IVec3};
use meniscus::internals::surface::mesh::Mesh;
use meniscus::internals::surface::mesh::compare::compare;
use rayon::prelude::*;

use super::components::{Count, components};
use super::lines::{Board, Line, Lost, Points, cell_name};
use super::programs::{Method, Program};
use crate::meshes::{sphere, torus};
use crate::sample::{Lattice, fill, unit_cube_point};
use crate::shapes::Solid;
use crate::tables::{figure, mean};
use crate::{Options, Outcome};

pub const JITTER: f64 = 0.3;
const SAMPLINGS: [(&str, f64); 2] = [("regular", 0.0), ("jittered", JITTER)];
/// Lattices have numbers. Isovalues are chosen on lattices from this number on, and results come
/// from lattices with lower numbers.
const CHOOSING: usize = 100;
/// Radius of the balls whose volume is measured.
const RADIUS: f64 = 5.0;
/// Number of balls whose volume is measured.
const BALLS: usize = 8;

/// The lattice with this number, which determines its rotation, position and jitter.
pub fn lattice(number: usize, jitter: f64) -> Lattice {
    let axis = (unit_cube_point(number) - 0.5).normalize();
    let turn = DQuat::from_axis_angle(axis, 1.0 + number as f64);
    Lattice { shift: unit_cube_point(number), turn, jitter, inset: 0.0, seed: number as u64 }
}

/// The mean distance between two meshes, averaged over both directions, and the Hausdorff distance.
fn distances(truth: &Mesh, mesh: &Mesh) -> Outcome<[f64; 2]> {
    let found = compare(truth, mesh)?;
    Ok([(found.from_mesh.mean + found.from_reference.mean) / 2.0, found.hausdorff])
}

/// The methods to compare: every program with its documented settings, and again with its best
/// isovalue if this differs from the documented one.
pub fn methods(options: &Options, programs: &[Program]) -> Outcome<Vec<Method>> {
    let particles = options.choose(8_000, 2_000);
    let solids = [
        Solid::new("sphere", sphere(1.0, 5), particles)?,
        Solid::new("torus", torus(96, 48), particles)?,
    ];
    let board = Board::new(Vec::new())?;
    let scenes: Vec<_> = solids
        .iter()
        .enumerate()
        .map(|(n, solid)| (solid, fill(solid, &lattice(CHOOSING + n, JITTER))))
        .collect();
    let scenes: Vec<_> = scenes
        .iter()
        .map(|(solid, points)| Ok((&solid.mesh, board.input(points)?)))
        .collect::<Outcome<_>>()?;
    let distance = |method: &Method| -> Outcome<f64> {
        let of = |(truth, input): &(&Mesh, PathBuf)| -> Outcome<f64> {
            let mesh = board.mesh(method, input, None)?;
            mesh.map_or(Ok(f64::INFINITY), |mesh| Ok(distances(truth, &mesh)?[0]))
        };
        Ok(mean(scenes.iter().map(of).collect::<Outcome<Vec<f64>>>()?))
    };
    let mut methods = Vec::new();
    println!(
        "isovalues: mean distance of a sphere and a torus that are in no other table, in \
         spacings:\n"
    );
    for program in programs {
        methods.push(program.documented());
        if program.isos.len() < 2 {
            continue;
        }
        let tried: Vec<(f64, &String)> = program
            .isos
            .par_iter()
            .with_max_len(1)
            .map(|iso| Ok((distance(&program.best(iso))?, iso)))
            .collect::<Outcome<_>>()?;
        let texts: Vec<String> =
            tried.iter().map(|(distance, iso)| format!("{iso}: {distance:.3}")).collect();
        println!("- {}: {} (the documented isovalue comes first)", program.name, texts.join(", "));
        let best = tried.iter().min_by(|one, other| one.0.total_cmp(&other.0));
        if let Some((_, iso)) = best.filter(|(_, iso)| **iso != program.isos[0]) {
            methods.push(program.best(iso));
        }
    }
    println!();
    Ok(methods)
}

pub fn run(options: &Options, board: &Board) -> Outcome<()> {
    let (few, many) = (options.choose(20_000, 3_000), options.choose(40_000, 5_000));
    let mut solids = vec![
        Solid::new("sphere", sphere(1.0, 5), few)?,
        Solid::new("torus", torus(128, 64), few)?,
        Solid::new("star with 32 tips", star(2.2), many)?,
        Solid::new("steps with sharp edges", steps(3), many)?,
    ];
    for file in &options.meshes {
        solids.insert(2, Solid::read(file, few)?);
    }
    let mut lines = Vec::new();
    for (number, solid) in solids.iter().enumerate() {
        for (sampling, jitter) in SAMPLINGS {
            // Use small cells only for jittered small bodies, because comparing fine meshes is
            // slow.
            let cells = if jitter > 0.0 && solid.volume == few as f64 {
                &[None, Some(0.5)][..]
            } else {
                &[None]
            };
            for &cell in cells {
                let truth = solid.mesh.clone();
                let row =
                    |what: &str| format!("{}, {sampling}, {}: {what}", solid.name, cell_name(cell));
                lines.push(Line {
                    rows: vec![row("mean"), row("Hausdorff")],
                    cell,
                    scenes: vec![fill(solid, &lattice(number, jitter)).into()],
                    lost: Lost::Row,
                    read: Box::new(move |meshes| {
                        Ok(distances(&truth, &meshes[0])?.map(figure).into())
                    }),
                });
            }
        }
    }
    board.table("distances to bodies filled with particles of a rotated lattice", lines)?;

    let ball = Solid::new(
        "ball",
        sphere(1.0, 5),
        (4.0 / 3.0 * std::f64::consts::PI * RADIUS.powi(3)) as usize,
    )?;
    let lines = SAMPLINGS.map(|(sampling, jitter)| Line {
        rows: vec![format!("volume, {sampling}")],
        cell: None,
        scenes: vec![balls(&ball, jitter).into()],
        lost: Lost::Row,
        read: Box::new(|meshes| {
            let volume = Count::of(&components(&meshes[0]).0).volume;
            let truth = 4.0 / 3.0 * std::f64::consts::PI * RADIUS.powi(3) * BALLS as f64;
            Ok(vec![figure(volume / truth)])
        }),
    });
    board.table("balls of radius 5: mesh volume / ball volume, mean of 8 lattices", lines.into())
}

/// The particles of several balls side by side, each on a different lattice.
fn balls(ball: &Solid, jitter: f64) -> Points {
    let of = |number: usize| {
        let by = DVec3::X * (6.0 * RADIUS * number as f64);
        fill(ball, &lattice(number, jitter)).into_iter().map(move |p| (DVec3::from(p) + by).into())
    };
    (0..BALLS).flat_map(of).collect()
}

/// A coarse ball with a spike on each triangle. The tips are `height` radii from the centre.
fn star(height: f64) -> Mesh {
    let mut star = sphere(1.0, 1);
    let triangles = std::mem::take(&mut star.triangles);
    for [a, b, c] in triangles {
        let corners = [a, b, c].map(|vertex| DVec3::from(star.positions[vertex as usize]));
        let tip = star.positions.len() as u32;
        star.positions.push((height * corners.iter().sum::<DVec3>().normalize()).into());
        star.triangles.extend([[a, b, tip], [b, c, tip], [c, a, tip]]);
    }
    star
}

/// A staircase in all three directions: unit cubes in a corner, `count` of them along each axis.
fn steps(count: i32) -> Mesh {
    let range = || 0..count;
    let cubes: HashSet<IVec3> = range()
        .flat_map(|x| range().flat_map(move |y| range().map(move |z| IVec3::new(x, y, z))))
        .filter(|cube| cube.element_sum() < count)
        .collect();
    let mut corners: Vec<IVec3> = Vec::new();
    let mut vertex = |corner: IVec3| {
        corners.iter().position(|&known| known == corner).unwrap_or_else(|| {
            corners.push(corner);
            corners.len() - 1
        }) as u32
    };
    let mut triangles = Vec::new();
    let mut sorted: Vec<IVec3> = cubes.iter().copied().collect();
    sorted.sort_by_key(IVec3::to_array);
    for cube in sorted {
        for axis in 0..3 {
            let [out, u, v] = [0, 1, 2].map(|n| IVec3::AXES[(axis + n) % 3]);
            for (neighbour, face) in [(cube + out, cube + out), (cube - out, cube)] {
                if cubes.contains(&neighbour) {
                    continue;
                }
                let mut quad = [face, face + u, face + u + v, face + v].map(&mut vertex);
                if neighbour == cube - out {
                    quad.reverse();
                }
                triangles.extend([[quad[0], quad[1], quad[2]], [quad[0], quad[2], quad[3]]]);
            }
        }
    }
    let positions = corners.iter().map(|corner| corner.as_dvec3().to_array()).collect();
    Mesh { positions, triangles, ..Mesh::default() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use meniscus::internals::surface::mesh::check::check;
    use meniscus::internals::surface::mesh::measure::measure;

    #[test]
    fn a_star_and_steps_are_closed_and_face_outwards() {
        for (mesh, volume) in [(star(2.2), None), (steps(3), Some(10.0)), (steps(2), Some(4.0))] {
            assert!(check(&mesh).is_closed_oriented_manifold());
            let measures = measure(&mesh);
            assert_eq!((measures.components, measures.genus), (1, Some(0)));
            let found = measures.volume.unwrap();
            assert!(volume.map_or(found > 4.0, |volume| (found - volume).abs() < 1e-9), "{found}");
        }
    }
}
