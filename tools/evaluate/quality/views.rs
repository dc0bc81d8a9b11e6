//! Draws pictures of frames with every method, all from the same camera and with the same light.

use std::collections::HashMap;

use glam::{DVec3, IVec3};
use meniscus::picture::Image;
use rayon::prelude::*;

use super::frames::Frame;
use super::lines::{Board, Points, cell_name};
use super::programs::Method;
use crate::camera::{Camera, write_sheet};
use crate::{Options, Outcome};

/// Width and height, in pixels, of a picture on a sheet.
const SMALL: [usize; 2] = [560, 420];
/// Width and height, in pixels, of a picture in a pair.
const LARGE: [usize; 2] = [960, 720];
const COLUMNS: usize = 3;
/// Distance of the camera relative to a view of the whole box. At this distance, a picture cuts off
/// the corners of the box, but shows its content larger.
const FAR: f64 = 0.8;
/// Radius of the region in a close-up, in spacings.
const NEAR: f64 = 14.0;
/// Radius within which particles are meshed for a close-up, in spacings.
const AROUND: f64 = 30.0;
/// To find the most detailed region, particles are counted in cells with this edge, in spacings.
const COUNTED: f64 = 3.0;
/// Partly filled cells are counted in regions with this edge, in cells.
const REGION: i32 = 6;

pub fn run(options: &Options, board: &Board, dam: &[Frame], given: &[Frame]) -> Outcome<()> {
    println!("Pictures:\n");
    for frame in dam.last().into_iter().chain(given) {
        let (lo, hi) = bounds(&frame.points);
        let far = Camera { radius: FAR * (hi - lo).length() / 2.0, ..Camera::of([lo, hi]) };
        views(options, board, &frame.name, "far", &frame.points, &far, None)?;
        let focus = most_detailed_region(&frame.points);
        let around: Points = frame
            .points
            .iter()
            .copied()
            .filter(|&p| DVec3::from(p).distance(focus) < AROUND)
            .collect();
        let near = Camera { centre: focus, radius: NEAR };
        for &cell in options.choose(&[0.5, 0.25][..], &[0.5]) {
            views(options, board, &frame.name, "near", &around, &near, Some(cell))?;
        }
    }
    Ok(())
}

/// Draws a sheet with all methods, and a larger picture of the first two methods side by side.
fn views(
    options: &Options,
    board: &Board,
    name: &str,
    view: &str,
    points: &[[f64; 3]],
    camera: &Camera,
    cell: Option<f64>,
) -> Outcome<()> {
    let input = board.input(points)?;
    let is_drawn = |method: &&Method| method.documented && method.takes(points.len());
    let methods: Vec<&Method> = board.methods.iter().filter(is_drawn).collect();
    let pictures: Vec<(Image, Option<Image>)> = methods
        .par_iter()
        .enumerate()
        .with_max_len(1)
        .map(|(n, method)| {
            let mesh = board.mesh(method, &input, cell)?.unwrap_or_default();
            let label = format!("{}, {}", method.name, cell_name(cell.or(method.program.cell)));
            let picture = |size| Outcome::Ok(camera.picture(&mesh, size)?.labelled(&label));
            Ok((picture(SMALL)?, (n < 2).then(|| picture(LARGE)).transpose()?))
        })
        .collect::<Outcome<_>>()?;
    let stem = format!("{name} {view} {}", cell_name(cell)).replace(' ', "-");
    let (small, large): (Vec<Image>, Vec<Option<Image>>) = pictures.into_iter().unzip();
    let large: Vec<Image> = large.into_iter().flatten().collect();
    for (file, pictures, columns) in
        [(format!("{stem}.png"), small, COLUMNS), (format!("{stem}-beside.png"), large, 2)]
    {
        write_sheet(&pictures, columns, &options.out.join(&file))?;
        println!("- {file}");
    }
    Ok(())
}

fn bounds(points: &[[f64; 3]]) -> (DVec3, DVec3) {
    let none = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    points.iter().fold(none, |(lo, hi), &p| (lo.min(p.into()), hi.max(p.into())))
}

/// The centre of the region that has the most partly filled cells.
fn most_detailed_region(points: &[[f64; 3]]) -> DVec3 {
    let mut counts: HashMap<IVec3, usize> = HashMap::new();
    for &p in points {
        *counts.entry((DVec3::from(p) / COUNTED).floor().as_ivec3()).or_default() += 1;
    }
    let half = COUNTED.powi(3) / 2.0;
    let mut regions: HashMap<IVec3, usize> = HashMap::new();
    for (cell, _) in counts.iter().filter(|&(_, &count)| (count as f64) < half) {
        *regions.entry(cell.div_euclid(IVec3::splat(REGION))).or_default() += 1;
    }
    let most = regions.iter().max_by_key(|(region, count)| (**count, region.to_array()));
    most.map_or(DVec3::ZERO, |(region, _)| (region.as_dvec3() + 0.5) * COUNTED * f64::from(REGION))
}
