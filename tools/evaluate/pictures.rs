//! Pictures of every method from one camera, and meshes coloured by their distance from the true
//! surface.

use std::fs::{self, File};
use std::io::{BufWriter, Write};
use std::path::Path;

use glam::{DQuat, DVec3, Vec3};
use meniscus::internals::field::spacing;
use meniscus::internals::frame::{Detail, Normals};
use meniscus::internals::io::bytes::Unpacking;
use meniscus::internals::io::input::open_particles;
use meniscus::internals::particles::{Particles, bounds};
use meniscus::internals::surface::mesh::{Mesh, VertexAttribute};
use meniscus::internals::system::timings::Timings;
use meniscus::picture::{Colour, Image};
use rayon::prelude::*;

use crate::camera::{Camera, write, write_sheet};
use crate::methods::{Iso, Method, grid};
use crate::sample::{Lattice, fill, unit_cube_point};
use crate::scene::splash;
use crate::shapes::{Solid, solids};
use crate::{Options, Outcome};

const SIZE: [usize; 2] = [960, 720];
/// Width and height of a picture on the contact sheet, in pixels.
const SMALL: [usize; 2] = [400, 300];
const JITTER: f64 = 0.3;
/// Distance, in spacings, from the true surface at which colours are saturated.
const FULL_COLOUR: f64 = 0.5;
const SIGMAS: [f64; 4] = [0.8, 1.0, 1.2, 1.5];
const ISOS: [Iso; 5] = [Iso::At(0.02), Iso::At(0.05), Iso::At(0.1), Iso::At(0.2), Iso::Auto];

/// The particles in the pictures, from a file or a generated splash.
struct Scene {
    particles: Box<dyn Particles>,
    spacing: f64,
    camera: Camera,
}

/// The particles of a generated splash.
struct Splash(Vec<[f32; 3]>);

impl Particles for Splash {
    fn len(&self) -> usize {
        self.0.len()
    }

    fn positions(&self, first: usize, out: &mut [[f64; 3]]) {
        self.0[..].positions(first, out);
    }
}

impl Scene {
    fn new(options: &Options) -> Outcome<Self> {
        let (particles, known): (Box<dyn Particles>, _) = match &options.frame {
            None => (Box::new(Splash(splash(options.choose(300_000, 10_000), 1))), Some(1.0)),
            Some(path) => {
                let file = open_particles(path, Unpacking::in_memory())?;
                (Box::new(file.particles), file.spacing)
            }
        };
        let spacing =
            known.or_else(|| spacing::estimate(&*particles)).ok_or("the spacing is not known")?;
        let bounds = bounds(&*particles).ok_or("there are no particles")?;
        Ok(Self { particles, spacing, camera: Camera::of([bounds.lo, bounds.hi]) })
    }

    fn picture(&self, method: &Method, size: [usize; 2]) -> Outcome<Image> {
        let surface = method.surface(
            &*self.particles,
            grid(self.spacing)?,
            self.spacing,
            Normals::None,
            &mut Timings::default(),
        )?;
        self.camera.picture(&surface.to_mesh()?, size)
    }
}

pub fn run(options: &Options) -> Outcome<()> {
    fs::create_dir_all(&options.out)?;
    let scene = Scene::new(options)?;
    println!("pictures in {}:\n", options.out.display());
    for method in Method::ALL.iter().copied().chain(Method::detailed(Detail::Recovered)) {
        let file = options.out.join(format!("frame-{}.png", method.slug()));
        write(&scene.picture(&method, SIZE)?, &file)?;
        println!("- {}: {}", file.display(), method.name());
    }
    for solid in &solids(options)? {
        for method in Method::ALL {
            truth(options, solid, method)?;
        }
    }
    println!();
    Ok(())
}

/// Draws a body's surface, coloured by its distance from the true surface: blue inside, red
/// outside.
fn truth(options: &Options, solid: &Solid, method: &Method) -> Outcome<()> {
    let lattice = Lattice {
        shift: unit_cube_point(0),
        turn: DQuat::IDENTITY,
        jitter: JITTER,
        inset: options.inset,
        seed: 1,
    };
    let particles = fill(solid, &lattice);
    let surface =
        method.surface(&particles[..], grid(1.0)?, 1.0, Normals::None, &mut Timings::default())?;
    let mut mesh = surface.to_mesh()?;
    let distances: Vec<f64> = mesh.positions.par_iter().map(|&p| -solid.depth(p.into())).collect();
    let colours: Vec<Vec3> =
        distances.iter().map(|distance| colour(distance / FULL_COLOUR)).collect();
    let stem = format!("{}-{}", solid.name, method.slug());
    let (ply, png) =
        (options.out.join(format!("{stem}.ply")), options.out.join(format!("{stem}.png")));
    write_coloured(&mesh, &colours, &ply)?;
    let reach = DVec3::splat(solid.radius / 3_f64.sqrt());
    let camera = Camera::of([solid.centre - reach, solid.centre + reach]);
    // The colour map starts with red, so negate distances to make the outside red.
    let values = distances.into_iter().map(|distance| -distance as f32).collect();
    mesh.attributes.push(VertexAttribute::new("inside", 1, values));
    let by_distance = Colour::Attribute { name: "inside".to_owned(), map: "red-blue".parse()? };
    let full = FULL_COLOUR as f32;
    write(&camera.coloured(&mesh, SIZE, by_distance, Some([-full, full]))?, &png)?;
    println!(
        "- {}, {}: {} by {}, from blue ({FULL_COLOUR} spacings inside the true surface) to red \
         (the same distance outside)",
        png.display(),
        ply.display(),
        solid.name,
        method.name()
    );
    Ok(())
}

/// The colour of a value from -1 (blue) over 0 (white) to 1 (red).
fn colour(share: f64) -> Vec3 {
    let share = share.clamp(-1.0, 1.0) as f32;
    let end = if share < 0.0 { Vec3::new(0.1, 0.25, 0.9) } else { Vec3::new(0.9, 0.15, 0.1) };
    Vec3::ONE.lerp(end, share.abs())
}

fn bytes(colour: Vec3) -> [u8; 3] {
    (colour * 255.0).round().to_array().map(|channel| channel as u8)
}

/// Writes a mesh as a .ply file with vertex colours, which other programs show by default.
fn write_coloured(mesh: &Mesh, colours: &[Vec3], path: &Path) -> Outcome<()> {
    let mut out = BufWriter::new(File::create(path)?);
    write!(
        out,
        "ply\nformat binary_little_endian 1.0\nelement vertex {}\n\
         property float x\nproperty float y\nproperty float z\n\
         property uchar red\nproperty uchar green\nproperty uchar blue\n\
         element face {}\nproperty list uchar int vertex_indices\nend_header\n",
        mesh.positions.len(),
        mesh.triangles.len()
    )?;
    for (position, &colour) in mesh.positions.iter().zip(colours) {
        out.write_all(position.map(|x| (x as f32).to_le_bytes()).as_flattened())?;
        out.write_all(&bytes(colour))?;
    }
    for triangle in &mesh.triangles {
        out.write_all(&[3])?;
        out.write_all(triangle.map(u32::to_le_bytes).as_flattened())?;
    }
    Ok(out.flush()?)
}

/// Draws contact sheets for several values of sigma and c (the paper's figure 7).
pub fn parameters(options: &Options) -> Outcome<()> {
    fs::create_dir_all(&options.out)?;
    let scene = Scene::new(options)?;
    println!("contact sheets: a row for each sigma, a column for each c:\n");
    for (name, of) in
        [("symmetry", Method::symmetry as fn(f64, Iso) -> Method), ("counting", Method::counting)]
    {
        let all = SIGMAS.into_iter().flat_map(|sigma| ISOS.map(|iso| (sigma, iso)));
        let pictures: Outcome<Vec<Image>> = all
            .map(|(sigma, iso)| {
                let c = match iso {
                    Iso::Auto => "auto".to_owned(),
                    Iso::At(c) => c.to_string(),
                };
                let picture = scene.picture(&of(sigma, iso), SMALL)?;
                Ok(picture.labelled(&format!("{name}, sigma {sigma}, c {c}")))
            })
            .collect();
        let file = options.out.join(format!("parameters-{name}.png"));
        write_sheet(&pictures?, ISOS.len(), &file)?;
        println!("- {}", file.display());
    }
    println!();
    Ok(())
}
