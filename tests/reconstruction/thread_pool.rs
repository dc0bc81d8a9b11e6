//! The library changes nothing in the rest of the program.

use meniscus::Reconstruction;

use crate::common::alone::alone;

#[test]
fn a_reconstruction_leaves_the_pool_of_threads_that_all_share_to_the_program() {
    // A process has one such pool, which is created once.
    let name =
        "thread_pool::a_reconstruction_leaves_the_pool_of_threads_that_all_share_to_the_program";
    alone(name, reconstruct_and_make_the_shared_pool);
}

fn reconstruct_and_make_the_shared_pool() {
    let steps = || (0..9).map(f64::from);
    let lattice = steps().flat_map(|x| steps().flat_map(move |y| steps().map(move |z| [x, y, z])));
    let particles: Vec<[f64; 3]> = lattice.collect();
    let surface = Reconstruction::new().threads(2).run(&particles[..]).unwrap();
    let folder = tempfile::TempDir::new().unwrap();
    surface.write(folder.path().join("mesh.ply")).unwrap();
    assert!(!surface.to_mesh().unwrap().triangles.is_empty());
    // Only its first user can create it.
    rayon::ThreadPoolBuilder::new().num_threads(1).build_global().unwrap();
    assert_eq!(rayon::current_num_threads(), 1);
}
