//! Tests that the library does not create the global thread pool, which belongs to the calling
//! program.

use meniscus::Reconstruction;

use crate::common::alone::alone;

#[test]
fn a_reconstruction_does_not_create_the_global_thread_pool() {
    // Run alone, because a process can create its global pool only once.
    let name = "thread_pool::a_reconstruction_does_not_create_the_global_thread_pool";
    alone(name, reconstruct_and_create_the_global_pool);
}

fn reconstruct_and_create_the_global_pool() {
    let steps = || (0..9).map(f64::from);
    let lattice = steps().flat_map(|x| steps().flat_map(move |y| steps().map(move |z| [x, y, z])));
    let particles: Vec<[f64; 3]> = lattice.collect();
    let surface = Reconstruction::new().threads(2).run(&particles[..]).unwrap();
    let folder = tempfile::TempDir::new().unwrap();
    surface.write(folder.path().join("mesh.ply")).unwrap();
    assert!(!surface.to_mesh().unwrap().triangles.is_empty());
    // This fails if the reconstruction has created the global pool.
    rayon::ThreadPoolBuilder::new().num_threads(1).build_global().unwrap();
    assert_eq!(rayon::current_num_threads(), 1);
}
