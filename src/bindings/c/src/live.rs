//! A simulation that runs: frames from memory, one after the other, all alike.

use meniscus::{LiveSimulation, Reconstruction};
use parking_lot::Mutex;

use crate::control::{Control, free};
use crate::frame::making;
use crate::mesh::MeniscusMesh;
use crate::options::{Asked, MeniscusOptions};
use crate::particles::{Borrowed, MeniscusParticles};
use crate::status::{Failure, MeniscusStatus, ask};

/// A simulation whose frames come from memory, one after the other. Freed by
/// meniscus_simulation_free.
///
/// Cells, grid and calibration are measured on the first frame with fluid deeper than the filters
/// reach, and frozen: the frames from then on are alike. It makes one frame at a time.
pub struct MeniscusSimulation {
    live: Mutex<LiveSimulation>,
    control: Control,
}

/// Starts threads for a simulation, of which nothing is known yet.
///
/// `options` may be NULL for all defaults; its callback and what that is given have to be there
/// until the simulation is freed. A callback ends one frame early, a handle also all that come
/// later. `simulation`: where to put the handle, to be freed by meniscus_simulation_free; NULL
/// where it fails.
///
/// Pointers are NULL or point to the described data.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_simulation_new(
    options: *const MeniscusOptions,
    simulation: *mut *mut MeniscusSimulation,
) -> MeniscusStatus {
    let started = || {
        // SAFETY: as for this function.
        let asked = unsafe { Asked::new(options) }?.on_machine(|_| None)?;
        Ok(MeniscusSimulation {
            live: Mutex::new(LiveSimulation::new(&asked.request)?),
            control: asked.control,
        })
    };
    // SAFETY: as for this function.
    unsafe { making(simulation, "simulation", started) }
}

/// Reconstructs the surface of the next frame.
///
/// A frame without particles, or without a surface, is an empty mesh. Otherwise returns what
/// meniscus_reconstruct does; the next frame may do better than one that fails.
/// MENISCUS_STATUS_REQUEST while the simulation is at work on another frame.
///
/// Pointers are NULL or point to the described data; the particles stay as they are meanwhile.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_simulation_frame(
    simulation: *mut MeniscusSimulation,
    particles: *const MeniscusParticles,
    mesh: *mut *mut MeniscusMesh,
) -> MeniscusStatus {
    let made = || {
        // SAFETY: as for this function.
        let simulation = unsafe { simulation.as_ref() };
        let MeniscusSimulation { live, control } =
            simulation.ok_or_else(|| Failure::request("simulation is NULL"))?;
        // SAFETY: as for this function.
        let particles = unsafe { Borrowed::new(particles) }?;
        // A callback that asked for a frame would wait for itself.
        let Some(mut live) = live.try_lock() else {
            return Err(Failure::request("the simulation is at work on another frame"));
        };
        let control = control.anew();
        live.set_control(&control.of(Reconstruction::new()));
        let _listening = control.listen();
        Ok(MeniscusMesh::new(live.frame(&particles)?))
    };
    // SAFETY: as for this function.
    unsafe { making(mesh, "mesh", made) }
}

/// Returns 1 once cells, grid and calibration are frozen, else 0; 0 of NULL, and while a frame is
/// made.
///
/// `simulation` is NULL, or a handle that is not freed yet.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_simulation_is_settled(
    simulation: *const MeniscusSimulation,
) -> i32 {
    // SAFETY: as for this function.
    let simulation = unsafe { simulation.as_ref() };
    let live = simulation.and_then(|simulation| simulation.live.try_lock());
    ask(0, || live.is_some_and(|live| live.is_settled()).into())
}

/// Frees a simulation; NULL is ignored. Meshes that it made stay.
///
/// `simulation` is NULL, or a handle that is not freed yet.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_simulation_free(simulation: *mut MeniscusSimulation) {
    // SAFETY: as for this function.
    unsafe { free(simulation) };
}
