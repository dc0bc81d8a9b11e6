//! Tests of pictures: every way of drawing shows the mesh, and a picture file is complete or does
//! not exist.
#![cfg(feature = "pictures")]
#![allow(clippy::unwrap_used)]

mod common;

use std::collections::BTreeMap;
use std::f64::consts::PI;
use std::fs::{self, File};
use std::io::BufReader;
use std::path::Path;
use std::process::Output;
#[cfg(unix)]
use std::process::{Child, Command};

use common::files::raw;
use common::fill;
use common::program::{self, command};
use common::scene::Random;
use common::shapes::{cuboid, sphere, torus};
use meniscus::error::CompareError;
use meniscus::files::Replace;
use meniscus::internals::surface::mesh::compare::Side;
use meniscus::mesh::MeshSource;
use meniscus::mesh::{Mesh, VertexAttribute};
use meniscus::picture::{
    Colour, Effort, Image, Picture, PictureError, Pictures, Reference, Scope, View,
};
use meniscus::{Cancel, Cause, Error, Reconstruction, Surface, UpAxis};
use rayon::ThreadPoolBuilder;
use tempfile::TempDir;

const RED: Colour = Colour::Solid([255, 0, 0]);

fn small() -> Picture {
    Picture::new().size(160, 120)
}

/// Whether a pixel is red. The backdrop is grey or blue.
fn is_red(pixel: &[u8]) -> bool {
    i32::from(pixel[0]) > i32::from(pixel[2]) + 40
}

fn red(image: &Image) -> usize {
    image.rgb().chunks(3).filter(|pixel| is_red(pixel)).count()
}

/// The bounding box of the red pixels: their first and last column, and their first and last row.
fn red_box(image: &Image) -> [usize; 4] {
    let places = || {
        let pixels = image.rgb().chunks(3).enumerate().filter(|(_, pixel)| is_red(pixel));
        pixels.map(|(n, _)| [n % image.width(), n / image.width()])
    };
    let [left, right] =
        [places().map(|p| p[0]).min().unwrap(), places().map(|p| p[0]).max().unwrap()];
    let [top, bottom] =
        [places().map(|p| p[1]).min().unwrap(), places().map(|p| p[1]).max().unwrap()];
    [left, right, top, bottom]
}

fn on_threads<T: Send>(threads: usize, work: impl FnOnce() -> T + Send) -> T {
    ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(work)
}

#[test]
fn a_picture_is_independent_of_the_number_of_threads() {
    let mesh = torus(60, 40);
    let picture = small().ground(true);
    let draw = |threads| on_threads(threads, || picture.draw(&mesh).unwrap());
    let one = draw(1);
    assert!([2, 3, 7].into_iter().all(|threads| draw(threads) == one));
    let mut png = Vec::new();
    one.write_png(&mut png).unwrap();
    let mut again = Vec::new();
    draw(2).write_png(&mut again).unwrap();
    assert_eq!(png, again);
}

#[test]
fn a_ball_covers_the_area_that_its_perspective_projection_predicts() {
    let (radius, distance) = (1.0, 6.0_f64);
    let ball = sphere(radius, 6);
    let size = 300.0;
    for eye in [[0.0, 0.0, 1.0], [0.6, 0.8, 0.0], [0.0, 1.0, 0.0], [-0.48, -0.6, 0.64]] {
        let view = View::At { eye: eye.map(|x: f64| x * distance), target: [0.0; 3] };
        let image = Picture::new().size(300, 300).colour(RED).view(view).draw(&ball).unwrap();
        // Half of the vertical field of view is 14 degrees.
        let tangent = radius / (distance * distance - radius * radius).sqrt();
        let radius_seen = tangent / 14.0_f64.to_radians().tan() * size / 2.0;
        let (found, expected) = (red(&image) as f64, PI * radius_seen * radius_seen);
        assert!((found / expected - 1.0).abs() < 0.01, "{eye:?}: {found} pixels for {expected}");
    }
}

#[test]
fn every_box_fits_the_picture_and_nearly_fills_it_from_any_direction() {
    let mut random = Random::new(3);
    for n in 0..60 {
        let size = [(); 3].map(|()| 10.0_f64.powf(2.0 * random.unit() - 1.0));
        let low = [(); 3].map(|()| 100.0 * (random.unit() - 0.5));
        let mesh = cuboid(low, std::array::from_fn(|i| low[i] + size[i]));
        let pixels = [[200, 100], [100, 200], [150, 150]][n % 3];
        let mut picture = Picture::new().size(pixels[0], pixels[1]).colour(RED);
        picture = picture.up([UpAxis::Y, UpAxis::Z][n % 2]);
        if n % 4 != 0 {
            let (azimuth, elevation) = (360.0 * random.unit(), 80.0 * random.unit());
            picture = picture.view(View::From { azimuth, elevation, zoom: 1.0 });
        }
        let image = picture.draw(&mesh).unwrap();
        let [left, right, top, bottom] = red_box(&image);
        assert!(
            left > 0 && top > 0 && right < pixels[0] - 1 && bottom < pixels[1] - 1,
            "{n}: {size:?}"
        );
        let filled = [(right - left + 1, pixels[0]), (bottom - top + 1, pixels[1])];
        let filled = filled.map(|(seen, all)| seen as f64 / all as f64);
        assert!(filled[0].max(filled[1]) > 0.85, "{n}: {size:?} fills {filled:?}");
    }
}

#[test]
fn the_up_axis_points_up_in_the_picture() {
    // A tower that is tall along y.
    let tower = cuboid([0.0; 3], [1.0, 10.0, 1.0]);
    let draw = |up| red_box(&small().up(up).colour(RED).draw(&tower).unwrap());
    let [left, right, top, bottom] = draw(UpAxis::Y);
    assert!(bottom - top > 3 * (right - left), "with y up, the tower must stand");
    let [left, right, top, bottom] = draw(UpAxis::Z);
    assert!(right - left > bottom - top, "with z up, the tower must lie on its side");
}

#[test]
fn deeper_water_is_bluer_and_an_empty_mesh_shows_the_backdrop() {
    let depth = |thick: f64| {
        let slab = cuboid([-1.0, -1.0, -thick], [1.0, 1.0, 0.0]);
        let view = View::At { eye: [0.0, 0.0, 8.0], target: [0.0; 3] };
        let mut whole = Scope::default();
        whole.bounds = Some([[-1.0; 3], [1.0; 3]]);
        let image = small().view(view).scope(whole).draw(&slab).unwrap();
        let middle = 3 * (60 * 160 + 80);
        [image.rgb()[middle], image.rgb()[middle + 2]].map(i32::from)
    };
    let shades = [0.02, 0.1, 0.4, 1.0].map(depth);
    // Deeper water absorbs more red light.
    assert!(shades.is_sorted_by(|a, b| a[0] > b[0]), "{shades:?}");
    assert!(shades.iter().all(|[red, blue]| blue > red), "{shades:?}");
    let nothing = small().draw(&Mesh::default()).unwrap();
    let [first, .., last] = [0, 1, 2].map(|n| &nothing.rgb()[3 * (119 * 160 * n / 2)..][..3]);
    assert_ne!(first, last, "the backdrop has no gradient");
}

#[test]
fn attribute_values_span_the_colour_map_and_appear_in_the_legend() {
    let mut mesh = sphere(1.0, 5);
    let heights = mesh.positions.iter().map(|p| p[1] as f32).collect();
    let velocities = mesh.positions.iter().flat_map(|_| [3.0, 0.0, 4.0]).collect();
    mesh.attributes.push(VertexAttribute::new("height", 1, heights));
    mesh.attributes.push(VertexAttribute::new("velocity", 3, velocities));
    let by = |name: &str, map: &str| {
        small().colour(Colour::Attribute { name: name.into(), map: map.parse().unwrap() })
    };
    assert_eq!(by("height", "viridis").scope_of(&mesh).unwrap().range, Some([-1.0, 1.0]));
    assert_eq!(by("velocity", "viridis").scope_of(&mesh).unwrap().range, Some([5.0, 5.0]));
    // The colour map goes from red to blue, so low vertices are red and high vertices are blue.
    let image = by("height", "red-blue").draw(&mesh).unwrap();
    let at = |x: usize, y: usize| &image.rgb()[3 * (y * 160 + x)..][..3];
    let [bottom, top] = [at(80, 80), at(80, 40)];
    assert!(bottom[0] > bottom[2] && top[2] > top[0], "{bottom:?} {top:?}");
    // At the right edge, the legend replaces the backdrop.
    let plain = small().draw(&mesh).unwrap();
    let edge = |image: &Image| {
        image.rgb().chunks(3 * 160).map(|row| row[3 * 135..].to_vec()).collect::<Vec<_>>()
    };
    assert_ne!(edge(&image), edge(&plain));
    let missing = by("pressure", "magma").draw(&mesh).unwrap_err();
    assert_eq!(
        missing.to_string(),
        "the vertices have no attribute \"pressure\"; available attributes: height, velocity"
    );
    let unknown = "rainbow".parse::<meniscus::picture::ColourMap>().unwrap_err();
    assert!(
        unknown.to_string().starts_with("no colour map \"rainbow\"; available maps: viridis, "),
        "{unknown}"
    );
}

#[test]
fn triangles_behind_the_camera_and_to_its_sides_are_clipped() {
    let mesh = torus(40, 30);
    let mut random = Random::new(11);
    for n in 0..150 {
        let mut place = || [(); 3].map(|()| 4.0 * (random.unit() - 0.5));
        let view = View::At { eye: place(), target: place() };
        let picture = Picture::new().size(64, 48).view(view).ground(n % 2 == 0);
        assert_eq!(picture.draw(&mesh).unwrap().rgb().len(), 3 * 64 * 48);
    }
    // A camera inside the fluid must see only the fluid.
    let ball = sphere(1.0, 4);
    let inside = View::At { eye: [0.0; 3], target: [0.0, 0.0, 1.0] };
    assert_eq!(
        red(&Picture::new().size(64, 48).view(inside).colour(RED).draw(&ball).unwrap()),
        64 * 48
    );
}

#[test]
fn invalid_pictures_are_refused_and_invalid_triangles_ignored() {
    let ball = sphere(1.0, 2);
    let at = |eye, target| View::At { eye, target };
    let from = |azimuth, zoom| View::From { azimuth, elevation: 0.0, zoom };
    for picture in [
        small().size(0, 5),
        small().size(5, 1 << 16),
        small().view(at([1.0; 3], [1.0; 3])),
        small().view(at([f64::NAN; 3], [1.0; 3])),
        small().view(from(f64::INFINITY, 1.0)),
        small().view(from(0.0, 0.0)),
        small().view(from(0.0, -1.0)),
    ] {
        assert!(matches!(picture.draw(&ball), Err(PictureError::Size(..) | PictureError::View(_))));
    }
    let error = small().memory(1 << 20).draw(&ball).unwrap_err();
    assert!(
        matches!(error, PictureError::Memory { needed, allowed } if needed > allowed),
        "{error}"
    );
    let weird =
        Mesh { positions: vec![[f64::NAN; 3]; 3], triangles: vec![[0, 1, 2]], ..Mesh::default() };
    let nothing = small().draw(&Mesh::default()).unwrap();
    assert_eq!(small().draw(&weird).unwrap(), nothing);
    let endless = Mesh { positions: vec![[f64::INFINITY, 0.0, 1.0]; 3], ..weird };
    assert_eq!(small().draw(&endless).unwrap().rgb().len(), nothing.rgb().len());
    // A triangle with a missing vertex is ignored.
    let mut lacking = ball.clone();
    lacking.triangles.push([0, 1, 1 << 20]);
    assert_eq!(small().draw(&lacking).unwrap(), small().draw(&ball).unwrap());
}

#[test]
fn a_finely_triangulated_slab_shows_no_cracks() {
    // A slab with many thin triangles, seen from an angle at which samples hit every edge.
    let side = 60_u32;
    let mut slab = cuboid([-1.0, -1.0, -0.1], [1.0, 1.0, 0.1]);
    slab.triangles.retain(|t| t.iter().any(|&v| slab.positions[v as usize][2] < 0.0));
    let first = slab.positions.len() as u32;
    let at = |n: u32| 2.0 * (f64::from(n) / f64::from(side)).powi(3) - 1.0;
    for y in 0..=side {
        slab.positions.extend((0..=side).map(|x| [at(x), at(y), 0.1]));
    }
    for (x, y) in (0..side).flat_map(|y| (0..side).map(move |x| (x, y))) {
        let corner = |x: u32, y: u32| first + y * (side + 1) + x;
        let [a, b, c, d] = [corner(x, y), corner(x + 1, y), corner(x + 1, y + 1), corner(x, y + 1)];
        slab.triangles.extend([[a, b, c], [a, c, d]]);
    }
    let plain = cuboid([-1.0, -1.0, -0.1], [1.0, 1.0, 0.1]);
    let view = View::At { eye: [0.3, 0.2, 2.0], target: [0.1, 0.0, 0.0] };
    let picture = small().view(view);
    let [fine, coarse] = [&slab, &plain].map(|mesh| picture.draw(mesh).unwrap());
    // Through a crack, the backdrop would be visible in the middle of the picture.
    let middle = |image: &Image| {
        let rows = image.rgb().chunks(3 * 160).skip(30).take(60);
        rows.flat_map(|row| row[3 * 40..3 * 120].to_vec()).collect::<Vec<u8>>()
    };
    let differ =
        middle(&fine).iter().zip(middle(&coarse)).filter(|(a, b)| a.abs_diff(*b) > 6).count();
    assert_eq!(differ, 0, "of {}", middle(&fine).len());
}

#[test]
fn a_draft_resembles_the_full_picture() {
    let mesh = torus(120, 60);
    let picture = small().ground(true);
    let [full, draft] = [Effort::Full, Effort::Draft]
        .map(|effort| picture.clone().effort(effort).draw(&mesh).unwrap());
    assert_ne!(full, draft);
    let differences: Vec<u8> =
        full.rgb().iter().zip(draft.rgb()).map(|(a, b)| a.abs_diff(*b)).collect();
    // Pixels may differ only at edges. With a different camera, most of the body's pixels would
    // differ.
    let far = differences.iter().filter(|&&difference| difference > 24).count();
    assert!(100 * far < differences.len(), "{far} of {} channels", differences.len());
}

/// The unsimplified surface of a splashing dam break.
fn splash(request: &Reconstruction) -> Surface {
    let file = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/data/dambreak_small/ParticleData_Fluid_20.bgeo");
    request.run_file(file).unwrap()
}

#[test]
fn a_draft_draws_a_coarser_mesh_that_resembles_the_fine_one() {
    let surface = splash(&Reconstruction::new());
    let picture = small().size(120, 90).ground(true);
    let draft = picture.clone().effort(Effort::Draft);
    assert!(surface.mesh().vertex_count() > 2 * 120 * 90);
    let drawn = draft.draw(surface.mesh()).unwrap();
    let coarser = surface.mesh().coarser().unwrap().unwrap();
    let of_all = draft.draw(&surface.to_mesh().unwrap()).unwrap();
    assert_eq!(drawn, draft.draw(&*coarser).unwrap());
    assert_ne!(drawn, of_all);
    let [far, near] = [24, 8].map(|limit| {
        drawn.rgb().iter().zip(of_all.rgb()).filter(|(a, b)| a.abs_diff(**b) > limit).count()
    });
    let channels = drawn.rgb().len();
    assert!(
        100 * far < 2 * channels && 100 * near < 6 * channels,
        "{far} and {near} of {channels}"
    );
    // Pictures with a wireframe or attributes, and pictures that are not drafts, use all triangles.
    let by_velocity =
        Colour::Attribute { name: "velocity".into(), map: "viridis".parse().unwrap() };
    for picture in [draft.clone().wireframe(true), draft.colour(by_velocity), picture.clone()] {
        assert_eq!(
            picture.draw(surface.mesh()).unwrap(),
            picture.draw(&surface.to_mesh().unwrap()).unwrap()
        );
    }
    let with_normals = splash(&Reconstruction::new().normals(true));
    assert_eq!(
        picture.draw(with_normals.mesh()).unwrap(),
        picture.draw(&with_normals.to_mesh().unwrap()).unwrap()
    );
}

#[test]
fn a_coarser_mesh_is_closed_near_the_surface_and_the_same_in_pieces() {
    let surface = splash(&Reconstruction::new());
    let fine = surface.mesh();
    let mesh = fine.coarser().unwrap().unwrap();
    let (positions, triangles) = mesh.at_once().unwrap().unwrap();
    assert_eq!(positions.len() as u64, mesh.vertex_count());
    assert!(4 * positions.len() as u64 <= 2 * fine.vertex_count(), "{}", positions.len());
    assert!(2 * triangles.len() as u64 <= fine.triangle_count(), "{}", triangles.len());
    let mut edges = BTreeMap::new();
    for triangle in &triangles {
        for n in 0..3 {
            let [from, to] = [triangle[n], triangle[(n + 1) % 3]];
            assert_ne!(from, to);
            let direction = if from < to { 1 } else { -1 };
            *edges.entry([from.min(to), from.max(to)]).or_insert(0) += direction;
        }
    }
    assert!(
        edges.values().all(|&sum| sum == 0),
        "an edge has different numbers of triangles in its two directions"
    );
    let mut pieced = (Vec::new(), Vec::new());
    for piece in 0..mesh.pieces() {
        pieced.0.extend(mesh.vertices(piece).unwrap().positions.iter().copied());
        pieced
            .1
            .extend(mesh.triangles(piece).unwrap().iter().map(|t| t.map(|vertex| vertex as u32)));
    }
    assert!(pieced == (positions, triangles));
    // Every vertex of the coarse mesh must be within two cells of the surface.
    let all = fine.at_once().unwrap().unwrap();
    let whole = surface.to_mesh().unwrap();
    assert!(all == (whole.positions.clone(), whole.triangles.clone()));
    let coarse = Mesh { positions: pieced.0, triangles: pieced.1, ..Mesh::default() };
    let from =
        Colour::Distance { from: Reference::new(&whole).unwrap(), map: "turbo".parse().unwrap() };
    let range = small().colour(from).scope_of(&coarse).unwrap().range.unwrap();
    let cell = 0.5 * 0.05;
    assert!(range.iter().all(|distance| distance.abs() < 2.0 * cell), "{range:?}");
}

#[test]
fn a_draft_is_independent_of_threads_and_memory() {
    let surface = splash(&Reconstruction::new().cell(0.25));
    let draft = small().ground(true).effort(Effort::Draft);
    let draw = |threads| on_threads(threads, || draft.draw(surface.mesh()).unwrap());
    let one = draw(1);
    assert!([2, 3, 7].into_iter().all(|threads| draw(threads) == one));
    // Drawing must also work with less memory than all visible triangles need.
    assert_eq!(draft.clone().memory(28 << 20).draw(surface.mesh()).unwrap(), one);
}

#[test]
fn a_mesh_larger_than_the_memory_budget_gives_the_same_picture() {
    let mut mesh = torus(1200, 600);
    let heights = mesh.positions.iter().map(|p| p[1] as f32).collect();
    mesh.attributes.push(VertexAttribute::new("height", 1, heights));
    let by_height = Colour::Attribute { name: "height".into(), map: "viridis".parse().unwrap() };
    let mut with_normals = mesh.clone();
    with_normals.normals = Some(mesh.positions.iter().map(|p| [p[0] as f32, 1.0, 0.5]).collect());
    for (mesh, colour) in
        [(&mesh, Colour::Water), (&mesh, by_height.clone()), (&with_normals, by_height)]
    {
        let picture = small().colour(colour);
        let whole = picture.draw(mesh).unwrap();
        // Use less memory than the vertices and triangles need.
        let memory = 40 << 20;
        assert!(56 * mesh.vertex_count() + 12 * mesh.triangle_count() > memory);
        assert_eq!(picture.clone().memory(memory).draw(mesh).unwrap(), whole);
        let refused = picture.memory(20 << 20).draw(mesh).unwrap_err();
        assert!(
            matches!(refused, PictureError::Memory { needed, .. } if needed > 20 << 20),
            "{refused}"
        );
    }
}

#[test]
fn streaming_a_large_file_gives_the_same_picture() {
    let folder = TempDir::new().unwrap();
    let mut mesh = torus(1200, 600);
    let velocities = mesh.positions.iter().flat_map(|p| p.map(|x| x as f32)).collect();
    mesh.attributes.push(VertexAttribute::new("velocity", 3, velocities));
    let write = |name: &str, mesh: &Mesh| {
        let file = folder.path().join(name);
        let output =
            meniscus::internals::io::output::MeshOutput::prepare(&file, Replace::Refuse).unwrap();
        output.write(mesh, meniscus::internals::io::CoordinateWidth::F32).unwrap();
    };
    write("large.ply", &mesh);
    let run = |output: &str, memory: &str| {
        let arguments = [
            "large.ply",
            "-o",
            output,
            "--size",
            "160x120",
            "--colour",
            "velocity",
            "--memory",
            memory,
        ];
        render(folder.path(), &arguments)
    };
    assert!(run("whole.png", "2GiB").status.success());
    let streamed = run("streamed.png", "60MiB");
    assert!(streamed.status.success(), "{}", String::from_utf8_lossy(&streamed.stderr));
    let bytes = |name: &str| fs::read(folder.path().join(name)).unwrap();
    assert_eq!(bytes("whole.png"), bytes("streamed.png"));
    // A face that is not a triangle is reported with its position.
    let file = folder.path().join("large.ply");
    let mut broken = fs::read(&file).unwrap();
    let last = broken.len() - 13;
    broken[last] = 4;
    fs::write(&file, broken).unwrap();
    let broken = run("broken.png", "60MiB");
    assert_eq!(broken.status.code(), Some(3));
    let errors = String::from_utf8_lossy(&broken.stderr).into_owned();
    assert!(errors.contains("large.ply") && errors.contains("triangles"), "{errors}");
    assert!(!folder.path().join("broken.png").exists());
}

#[test]
fn a_wireframe_shows_only_edges_of_triangles_wider_than_its_lines() {
    let ink = |mesh: &Mesh| {
        let image = small().colour(RED).wireframe(true).draw(mesh).unwrap();
        image.rgb().chunks(3).filter(|pixel| pixel.iter().all(|&channel| channel < 110)).count()
    };
    let dark = |mesh: &Mesh| {
        let image = small().colour(RED).draw(mesh).unwrap();
        image.rgb().chunks(3).filter(|pixel| pixel.iter().all(|&channel| channel < 110)).count()
    };
    let coarse = sphere(1.0, 2);
    assert!(ink(&coarse) > dark(&coarse) + 300, "{} {}", ink(&coarse), dark(&coarse));
    let fine = sphere(1.0, 7);
    assert!(ink(&fine) < dark(&fine) + 100, "{} {}", ink(&fine), dark(&fine));
}

#[test]
fn distances_from_a_reference_are_signed_and_coloured_around_zero() {
    let reference = Reference::new(&sphere(1.0, 5)).unwrap();
    let by = Colour::Distance { from: reference, map: "red-blue".parse().unwrap() };
    let picture = small().colour(by);
    for (radius, blue) in [(1.1, true), (0.9, false)] {
        let ball = sphere(radius, 4);
        let [lo, hi] = picture.scope_of(&ball).unwrap().range.unwrap();
        assert!(lo == -hi && (hi - 0.1).abs() < 0.01, "{lo} {hi}");
        let image = picture.draw(&ball).unwrap();
        let middle = &image.rgb()[3 * (60 * 160 + 80)..][..3];
        assert_eq!(middle[2] > middle[0], blue, "{radius}: {middle:?}");
    }
    let nothing = Reference::new(&Mesh::default()).unwrap_err();
    let empty = CompareError::NoSurface(Side::Reference);
    assert!(matches!(nothing, PictureError::Reference(fault) if fault == empty), "{nothing:?}");

    let folder = frames();
    let run = |arguments: &[&str]| {
        let out = render(folder.path(), arguments);
        (out.status.code(), String::from_utf8_lossy(&out.stderr).into_owned())
    };
    let arguments = ["ball_2.ply", "-o", "a.png", "--size", "96x54", "--reference"];
    let with = |more: &[&'static str]| run(&[&arguments[..], more].concat());
    assert_eq!(with(&["ball_7.ply"]).0, Some(0));
    assert_eq!(with(&["ball_7.ply", "--colour", "distance:turbo", "--overwrite"]).0, Some(0));
    let (code, errors) = with(&["ball_7.ply", "--colour", "ff0000", "--overwrite"]);
    assert!(code == Some(2) && errors.contains("--colour distance"), "{errors}");
    let (code, errors) = with(&["gone.ply", "--overwrite"]);
    assert!(code == Some(3) && errors.contains("gone.ply"), "{errors}");
}

#[test]
fn an_outlier_does_not_widen_the_colour_range_but_marks_the_legend() {
    let reference = Reference::new(&sphere(1.0, 5)).unwrap();
    let colour = Colour::Distance { from: reference, map: "red-blue".parse().unwrap() };
    let mut bounds = Scope::default();
    bounds.bounds = Some([[-1.2; 3], [1.2; 3]]);
    let mut ball = sphere(1.1, 5);
    // Deform the ball, so that some vertices are inside the reference and others outside.
    ball.positions.iter_mut().for_each(|p| *p = p.map(|x| x * (1.0 + 0.1 * p[1])));
    let known = small().colour(colour.clone()).scope_of(&ball).unwrap();
    assert!(known.range.unwrap()[1] > 0.18);
    let farthest = (0..ball.positions.len())
        .min_by(|&a, &b| ball.positions[a][2].total_cmp(&ball.positions[b][2]));
    // Move one vertex far away, so that it is an outlier behind the camera.
    ball.positions[farthest.unwrap()] = [0.0, 0.0, -50.0];
    let found = small().colour(colour).scope_of(&ball).unwrap();
    assert!(
        found.beyond && (found.range.unwrap()[1] / known.range.unwrap()[1] - 1.0).abs() < 0.05,
        "{found:?}"
    );
    let legend = |beyond: bool| {
        let mut scope = found;
        (scope.bounds, scope.beyond) = (bounds.bounds, beyond);
        let heights = ball.positions.iter().map(|p| p[1] as f32).collect();
        let mut mesh = ball.clone();
        mesh.attributes.push(VertexAttribute::new("height", 1, heights));
        let colour = Colour::Attribute { name: "height".into(), map: "viridis".parse().unwrap() };
        small().colour(colour).scope(scope).draw(&mesh).unwrap()
    };
    assert_ne!(legend(true), legend(false));
}

#[test]
fn huge_tiny_degenerate_and_non_finite_meshes_can_be_drawn() {
    let ball = sphere(1.0, 4);
    let scaled = |by: f64| {
        let mut mesh = ball.clone();
        mesh.positions.iter_mut().for_each(|p| *p = p.map(|x| x * by));
        mesh
    };
    let expected = small().draw(&ball).unwrap();
    for by in [1e-30, 1e-9, 1e9, 1e30, 1e60] {
        let seen = small().draw(&scaled(by)).unwrap();
        let differ =
            seen.rgb().iter().zip(expected.rgb()).filter(|(a, b)| a.abs_diff(**b) > 4).count();
        assert!(differ < 100, "{by}: {differ} bytes differ");
    }
    // The bounds ignore vertices that are not finite or too far away.
    for wrong in [f64::NAN, f64::INFINITY, 1e200] {
        let mut mesh = ball.clone();
        mesh.positions.push([wrong, 0.0, 0.0]);
        mesh.triangles.push([0, 1, mesh.positions.len() as u32 - 1]);
        let seen = small().draw(&mesh).unwrap();
        let differ =
            seen.rgb().iter().zip(expected.rgb()).filter(|(a, b)| a.abs_diff(**b) > 40).count();
        assert!(differ < 2000, "{wrong}: {differ} bytes differ");
    }
    let flat = Mesh {
        positions: vec![[0.0; 3], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]],
        triangles: vec![[0, 1, 2], [0, 0, 1], [1, 1, 1]],
        ..Mesh::default()
    };
    let point =
        Mesh { positions: vec![[3.0; 3]; 3], triangles: vec![[0, 1, 2]], ..Mesh::default() };
    for mesh in [flat, point] {
        assert_eq!(
            small().ground(true).wireframe(true).draw(&mesh).unwrap().rgb().len(),
            3 * 160 * 120
        );
    }
    // Non-finite values are grey, and finite values keep their colours.
    let mut valued = ball.clone();
    let values = valued.positions.iter().map(|p| if p[1] > 0.0 { f32::NAN } else { p[0] as f32 });
    let values = values.collect();
    valued.attributes.push(VertexAttribute::new("broken", 1, values));
    let map = "red-blue".parse().unwrap();
    let image =
        small().colour(Colour::Attribute { name: "broken".into(), map }).draw(&valued).unwrap();
    let at = |x: usize, y: usize| [0, 1, 2].map(|c| i32::from(image.rgb()[3 * (y * 160 + x) + c]));
    let spread = |pixel: [i32; 3]| pixel.iter().max().unwrap() - pixel.iter().min().unwrap();
    assert!(
        spread(at(80, 30)) < 10 && spread(at(55, 75)) > 30,
        "{:?} {:?}",
        at(80, 30),
        at(55, 75)
    );
}

/// A folder with numbered meshes of a moving ball, and an unrelated file.
fn frames() -> TempDir {
    let folder = TempDir::new().unwrap();
    for n in [2, 10, 7] {
        let mut mesh = sphere(1.0, 3);
        mesh.positions.iter_mut().for_each(|p| p[0] += f64::from(n));
        meniscus::internals::io::output::MeshOutput::prepare(
            &folder.path().join(format!("ball_{n}.ply")),
            Replace::Refuse,
        )
        .unwrap()
        .write(&mesh, meniscus::internals::io::CoordinateWidth::F32)
        .unwrap();
    }
    fs::write(folder.path().join("ball.json"), "{}").unwrap();
    folder
}

fn render(folder: &Path, arguments: &[&str]) -> Output {
    command(folder, &["render"]).args(arguments).output().unwrap()
}

fn png_size(path: &Path) -> [u32; 2] {
    let reader = png::Decoder::new(BufReader::new(File::open(path).unwrap())).read_info().unwrap();
    [reader.info().width, reader.info().height]
}

#[test]
fn a_simulation_is_rendered_as_pictures_a_sheet_or_an_animation() {
    let folder = frames();
    let at = |name: &str| folder.path().join(name);
    let run = |arguments: &[&str]| {
        let out = render(folder.path(), arguments);
        assert!(out.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&out.stderr));
    };
    run(&["ball_{}.ply", "-o", "p_{}.png", "--size", "96x54", "--colour", "ff0000"]);
    fs::create_dir(at("out")).unwrap();
    run(&[".", "-o", "out/", "--size", "96x54", "--colour", "#ff0000", "-q"]);
    let read = |name: &str| {
        let mut reader =
            png::Decoder::new(BufReader::new(File::open(at(name)).unwrap())).read_info().unwrap();
        let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut bytes).unwrap();
        bytes
    };
    let columns = ["p_2.png", "p_7.png", "p_10.png"].map(|name| {
        assert_eq!(
            fs::read(at(name)).unwrap(),
            fs::read(at("out").join(name.replace("p_", "ball_"))).unwrap()
        );
        let bytes = read(name);
        let seen =
            bytes.chunks(3).enumerate().filter(|(_, pixel)| is_red(pixel)).map(|(n, _)| n % 96);
        let seen: Vec<usize> = seen.collect();
        seen.iter().sum::<usize>() / seen.len()
    });
    // The ball moves to the right.
    assert!(columns.is_sorted_by(|a, b| a + 10 < *b), "{columns:?}");

    run(&["ball_10.ply", "ball_2.ply", "ball_7.ply", "-o", "sheet.png", "--size", "96x54"]);
    assert_eq!(png_size(&at("sheet.png")), [3 * 96 + 2 * 4, 54]);
    run(&["ball_*.ply", "-o", "moves.apng", "--size", "96x54", "--fps", "10"]);
    let reader = png::Decoder::new(BufReader::new(File::open(at("moves.apng")).unwrap()))
        .read_info()
        .unwrap();
    assert_eq!(reader.info().animation_control().unwrap().num_frames, 3);
    assert_eq!(reader.info().frame_control().unwrap().delay_num, 100);
    run(&["ball_7.ply", "-o", "one.png", "--ground", "--camera", "30,20,2", "--up", "z"]);
    assert_eq!(png_size(&at("one.png")), [1920, 1080]);
}

#[test]
fn the_up_axis_of_a_picture_comes_from_the_mesh_file_or_its_listing() {
    let folder = TempDir::new().unwrap();
    let at = |name: &str| folder.path().join(name);
    // The tower is taller along z than it is wide.
    let tower = fill(6.0, 1.0, 0.2, 3, |p| p.x.abs() < 2.0 && p.y.abs() < 2.0);
    fs::write(at("f_1.xyz"), raw(&tower)).unwrap();
    let drawn = |mesh: &str, options: &[&str]| {
        let common = [mesh, "-o", "p.png", "--size", "64x36", "--overwrite"];
        let out = render(folder.path(), &[&common, options].concat());
        assert!(out.status.success(), "{mesh}: {}", String::from_utf8_lossy(&out.stderr));
        fs::read(at("p.png")).unwrap()
    };
    let common = ["reconstruct", "--spacing", "1", "--cell", "1", "--particles-up", "z"];
    for output in ["m.ply", "m.obj", "m.vtk", "m.vtp", "m.pvtp", "m.stl", "s_{}.vtkhdf"] {
        let input = if output.contains("{}") { "f_{}.xyz" } else { "f_1.xyz" };
        program::run(folder.path(), &[&common[..], &[input, "-o", output]].concat(), 0);
        let mesh = output.replace("{}", "1");
        let default = drawn(&mesh, &[]);
        assert!(default == drawn(&mesh, &["--up", "z"]), "{output}");
        assert!(default != drawn(&mesh, &["--up", "y"]), "{output}");
    }
    let rotated = [&common[..], &["f_1.xyz", "-o", "y.ply", "--up", "y"]].concat();
    program::run(folder.path(), &rotated, 0);
    assert!(drawn("y.ply", &[]) == drawn("y.ply", &["--up", "y"]));
}

#[cfg(unix)]
#[test]
fn an_interrupted_picture_leaves_no_files() {
    let folder = frames();
    let before = listing(folder.path());
    for output in ["large.png", "made/large.png", "moves.apng"] {
        let meshes = if output == "moves.apng" { "ball_*.ply" } else { "ball_2.ply" };
        let arguments = ["render", meshes, "-o", output, "--size", "8000x8000"];
        let mut child = command(folder.path(), &arguments).spawn().unwrap();
        let beside = folder.path().join(output).parent().unwrap().to_owned();
        let has_begun = |_: &Child| {
            let files = fs::read_dir(&beside).into_iter().flatten().flatten();
            files.map(|file| file.file_name()).any(|name| name.to_string_lossy().starts_with('.'))
        };
        program::wait_until(&mut child, "its temporary file", has_begun);
        let interrupted = Command::new("kill").args(["-TERM", &child.id().to_string()]).status();
        assert!(interrupted.unwrap().success());
        assert_eq!(child.wait().unwrap().code(), Some(130), "{output}");
        assert_eq!(listing(folder.path()), before, "{output}");
    }
}

#[test]
fn invalid_render_requests_are_refused_and_leave_no_files() {
    let folder = frames();
    fs::write(folder.path().join("there.png"), "mine").unwrap();
    fs::write(folder.path().join("bad.ply"), "ply\nformat ascii 1.0\nelement vertex 3\n").unwrap();
    let before = listing(folder.path());
    for (arguments, code, expected) in [
        (&["ball_2.ply", "-o", "there.png"][..], 2, "there.png: the file already exists"),
        (&["ball_2.ply", "-o", "a.jpg"], 2, "a.jpg: unknown extension; supported: .png, and .apng"),
        (&["ball_{}.ply", "-o", "a_{}.apng"], 2, "unknown extension; supported: .png"),
        (&["ball_2.ply", "-o", "a.apng"], 2, "an animation needs several meshes"),
        (&["ball_2.ply", "-o", "ball_2.ply", "--overwrite"], 2, "choose another output"),
        (&["ball_2.ply", "-o", "a.png", "--size", "0x5"], 2, "got 0 x 5"),
        (&["ball_2.ply", "-o", "a.png", "--size", "5"], 2, "a width and a height"),
        (&["ball_2.ply", "-o", "a.png", "--camera", "1,2,3,4"], 2, "--camera must be"),
        (&["ball_2.ply", "-o", "a.png", "--camera", "1,2,0"], 2, "zoom factor positive"),
        (
            &["ball_2.ply", "-o", "a.png", "--colour", "velocity"],
            2,
            "ball_2.ply: the vertices have no attribute \"velocity\"",
        ),
        (
            &["ball_2.ply", "-o", "a.png", "--colour", "velocity:mauve"],
            2,
            "no colour map \"mauve\"",
        ),
        (
            &["ball_2.ply", "-o", "a.png", "--memory", "1MiB"],
            2,
            "ball_2.ply: a picture of this mesh needs",
        ),
        (&["ball_2.ply", "-o", "a.png", "--reference", "bad.ply"], 3, "bad.ply"),
        (&["ball_2.ply", "-o", "ball_2.ply/a.png"], 4, "ball_2.ply/a.png"),
        (&["none.ply", "-o", "made/a.png"], 3, "none.ply"),
        (&["gone.ply", "-o", "a.png"], 3, "gone.ply"),
        (&["bad.ply", "-o", "a.png"], 3, "bad.ply"),
        (&["none_{}.ply", "-o", "a.png"], 3, "none_{}.ply: no file matches this pattern"),
    ] {
        let out = render(folder.path(), arguments);
        let errors = String::from_utf8_lossy(&out.stderr);
        assert_eq!(out.status.code(), Some(code), "{arguments:?}: {errors}");
        assert!(errors.contains(expected), "{arguments:?}: {errors}");
        assert_eq!(listing(folder.path()), before, "{arguments:?}");
    }
    assert_eq!(fs::read(folder.path().join("there.png")).unwrap(), b"mine");
}

#[test]
fn a_cancelled_or_failed_animation_leaves_no_file() {
    let folder = frames();
    let output = folder.path().join("moves.apng");
    let meshes = || folder.path().join("ball_{}.ply");
    let cancel = Cancel::new();
    let pictures =
        Pictures::new(Picture::new(), [meshes()], &output).size(32, 18).cancel(cancel.clone());
    let ended = pictures.run(|_| cancel.cancel()).unwrap_err();
    assert!(matches!(ended, Error::Cancelled));
    fs::write(folder.path().join("ball_8.ply"), "ply\n").unwrap();
    let bad =
        Pictures::new(Picture::new(), [meshes()], &output).size(32, 18).run(|_| ()).unwrap_err();
    assert_eq!(bad.cause(), Cause::Input);
    assert!(bad.to_string().contains("ball_8.ply"), "{bad}");
    let left: Vec<String> =
        listing(folder.path()).into_iter().filter(|name| !name.starts_with("ball")).collect();
    assert!(left.is_empty(), "{left:?}");
}

#[test]
fn a_preview_is_written_next_to_the_mesh_and_does_not_change_it() {
    let folder = TempDir::new().unwrap();
    let at = |name: &str| folder.path().join(name);
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/dambreak_small");
    let run = |arguments: &[&str], code| {
        program::run(folder.path(), &[&["reconstruct"], arguments].concat(), code)
    };
    let frame = data.join("ParticleData_Fluid_10.bgeo");
    let frame = frame.to_str().unwrap();
    run(&[frame, "-o", "plain.ply"], 0);
    run(&[frame, "-o", "seen.ply", "--preview"], 0);
    assert_eq!(fs::read(at("plain.ply")).unwrap(), fs::read(at("seen.ply")).unwrap());
    assert_eq!(png_size(&at("seen.png")), [640, 360]);
    // Rendering the mesh file must give the same picture, because the preview shows the written
    // mesh.
    fs::rename(at("seen.png"), at("first.png")).unwrap();
    let drawn =
        render(folder.path(), &["seen.ply", "-o", "seen.png", "--size", "640x360", "--ground"]);
    assert!(drawn.status.success());
    let near = |a: &[u8], b: &[u8]| {
        a.iter().zip(b).filter(|(a, b)| a.abs_diff(**b) > 8).count() * 100 < a.len()
    };
    let pixels = |name: &str| {
        let mut reader =
            png::Decoder::new(BufReader::new(File::open(at(name)).unwrap())).read_info().unwrap();
        let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut bytes).unwrap();
        bytes
    };
    assert!(near(&pixels("seen.png"), &pixels("first.png")));
    // If the preview's file exists, the run fails and makes no mesh.
    fs::write(at("other.png"), "mine").unwrap();
    let messages = run(&[frame, "-o", "other.ply", "--preview"], 2);
    assert!(
        messages.contains("other.png: the file already exists") && !at("other.ply").exists(),
        "{messages}"
    );
    run(&[frame, "-o", "p.ply", "--parts", "2", "--plan", "--preview"], 2);

    let frames = data.join("ParticleData_Fluid_{}.bgeo");
    let frames = frames.to_str().unwrap();
    run(&[frames, "-o", "mesh_{}.ply", "--preview"], 0);
    assert_eq!(png_size(&at("mesh.png")), [3 * 640 + 2 * 4, 360]);
    let messages = run(&[frames, "-o", "mesh_{}.ply", "--preview"], 2);
    assert!(messages.contains("mesh.png: the file already exists"), "{messages}");
    // Resuming may replace the conversion's own sheet, but no other picture.
    let sheet = fs::read(at("mesh.png")).unwrap();
    let picture = Picture::new().size(8, 8).draw(&Mesh::default()).unwrap();
    let mut foreign = Vec::new();
    picture.write_png(&mut foreign).unwrap();
    fs::write(at("mesh.png"), &foreign).unwrap();
    run(&[frames, "-o", "mesh_{}.ply", "--preview", "--resume"], 2);
    assert_eq!(fs::read(at("mesh.png")).unwrap(), foreign);
    fs::write(at("mesh.png"), &sheet).unwrap();
    fs::remove_file(at("mesh_10.ply")).unwrap();
    run(&[frames, "-o", "mesh_{}.ply", "--preview", "--resume"], 0);
    assert_eq!(fs::read(at("mesh.png")).unwrap(), sheet);
}

#[test]
fn previews_of_unreadable_formats_equal_those_of_readable_formats() {
    let folder = TempDir::new().unwrap();
    let at = |name: &str| folder.path().join(name);
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/dambreak_small");
    let frames = data.join("ParticleData_Fluid_{}.bgeo");
    let run = |arguments: &[&str], code| {
        let frames = ["reconstruct", frames.to_str().unwrap()];
        program::run(folder.path(), &[&frames, arguments].concat(), code)
    };
    let pixels = |name: &str| {
        let file = BufReader::new(File::open(at(name)).unwrap());
        let mut reader = png::Decoder::new(file).read_info().unwrap();
        let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut bytes).unwrap();
        bytes
    };
    run(&["-o", "read_{}.ply", "--preview"], 0);
    for output in ["a_{}.usdc", "b_{}.glb"] {
        let sheet = format!("{}.png", &output[..1]);
        run(&["-o", output, "--preview"], 0);
        assert_eq!(png_size(&at(&sheet)), [3 * 640 + 2 * 4, 360]);
        let (ours, read) = (pixels(&sheet), pixels("read.png"));
        let differing = ours.iter().zip(&read).filter(|(a, b)| a.abs_diff(**b) > 24).count();
        assert!(differing * 100 < ours.len(), "{output}: {differing} of {}", ours.len());
        // After resuming, the sheet must show the frames of both runs.
        fs::remove_file(at(&output.replace("{}", "10"))).unwrap();
        let whole = fs::read(at(&sheet)).unwrap();
        run(&["-o", output, "--preview", "--resume"], 0);
        assert_eq!(fs::read(at(&sheet)).unwrap(), whole, "{output}");
    }
    run(&["-o", "c_{}.glb"], 0);
    let messages = run(&["-o", "c_{}.glb", "--preview", "--resume"], 0);
    assert!(messages.contains("c_1.glb to c_20.glb") && !at("c.png").exists(), "{messages}");
    fs::remove_file(at("c_10.glb")).unwrap();
    let messages = run(&["-o", "c_{}.glb", "--preview", "--resume"], 0);
    assert!(
        messages.contains("c_1.glb") && messages.contains("1 of 3") && at("c.png").exists(),
        "{messages}"
    );
}

fn listing(folder: &Path) -> Vec<String> {
    let names = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap());
    let mut names: Vec<String> = names.collect();
    names.sort();
    names
}
