//! The library sets nothing for the rest of the program. Alone in its process, for that can be seen only once.
#![allow(clippy::unwrap_used)]

use meniscus::Reconstruction;

#[test]
fn a_reconstruction_leaves_the_pool_of_threads_that_all_share_to_the_program() {
    let steps = || (0..9).map(f64::from);
    let lattice = steps().flat_map(|x| steps().flat_map(move |y| steps().map(move |z| [x, y, z])));
    let particles: Vec<[f64; 3]> = lattice.collect();
    let surface = Reconstruction::new().threads(2).run(&particles[..]).unwrap();
    let folder = tempfile::TempDir::new().unwrap();
    surface.write(folder.path().join("mesh.ply")).unwrap();
    assert!(!surface.to_mesh().unwrap().triangles.is_empty());
    // It can be made only by whoever is the first to use it.
    rayon::ThreadPoolBuilder::new().num_threads(1).build_global().unwrap();
    assert_eq!(rayon::current_num_threads(), 1);
}
