//! Closed meshes as bodies of fluid, scaled so that particles have spacing 1, with depth queries.

use std::path::Path;

use glam::DVec3;
use meniscus::internals::io::output::read_mesh;
use meniscus::internals::surface::mesh::Mesh;
use meniscus::internals::surface::mesh::compare::SearchableSurface;
use meniscus::internals::surface::mesh::measure::measure;

use crate::meshes::{sphere, torus};
use crate::{Options, Outcome};

/// The centre of all bodies, chosen so that no vertex is exactly on the grid.
const CENTRE: DVec3 = DVec3::new(0.371, 0.113, 0.729);

/// A closed mesh, scaled so that its volume equals its number of particles.
pub struct Solid {
    pub name: String,
    pub mesh: Mesh,
    pub volume: f64,
    /// The centre of the mesh's bounding box.
    pub centre: DVec3,
    /// The radius of the sphere around the bounding box.
    pub radius: f64,
    search: SearchableSurface,
}

impl Solid {
    /// Scales a mesh to the volume `particles`: a cube of edge 1 for each particle.
    pub fn new(name: &str, mut mesh: Mesh, particles: usize) -> Outcome<Self> {
        let measures = measure(&mesh);
        let (Some([lo, hi]), Some(volume)) =
            (measures.bounds, measures.volume.filter(|&v| v > 0.0))
        else {
            return Err(format!("{name}: not a closed mesh that faces outwards").into());
        };
        let (lo, hi) = (DVec3::from(lo), DVec3::from(hi));
        let scale = (particles as f64 / volume).cbrt();
        for position in &mut mesh.positions {
            *position = (CENTRE + scale * (DVec3::from(*position) - (lo + hi) / 2.0)).into();
        }
        mesh = Mesh { normals: None, attributes: Vec::new(), ..mesh };
        let search =
            SearchableSurface::reference(&mesh).map_err(|fault| format!("{name}: {fault}"))?;
        let radius = scale * (hi - lo).length() / 2.0;
        Ok(Self {
            name: name.into(),
            mesh,
            volume: particles as f64,
            centre: CENTRE,
            radius,
            search,
        })
    }

    pub fn read(path: &Path, particles: usize) -> Outcome<Self> {
        let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        Self::new(&name, read_mesh(path)?, particles)
    }

    /// The distance of a point from the surface, positive inside.
    pub fn depth(&self, point: DVec3) -> f64 {
        -self.search.signed_distances(&[point.to_array()])[0]
    }
}

/// The bodies: a sphere, a torus, and the meshes that the user named.
pub fn solids(options: &Options) -> Outcome<Vec<Solid>> {
    let particles = options.particles();
    let (depth, across) = options.choose((5, 64), (4, 32));
    let mut solids = vec![
        Solid::new("sphere", sphere(1.0, depth), particles)?,
        Solid::new("torus", torus(2 * across, across), particles)?,
    ];
    for file in &options.meshes {
        solids.push(Solid::read(file, particles)?);
    }
    Ok(solids)
}
