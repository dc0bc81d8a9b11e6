//! Conformance tests of every backend: results equal those of an oracle to the bit, and surfaces
//! are watertight with the right topology.

mod oracle;
mod periodic;
mod sampled;
mod surfaces;

use std::convert::Infallible;

use meniscus::internals::backend::Backend;
use meniscus::internals::frame::Sampling;
use meniscus::internals::vulkan::VulkanError;

use crate::common;

/// A backend on which the tests run.
struct TestBackend {
    backend: Backend,
}

impl TestBackend {
    fn cpu() -> Result<Self, Infallible> {
        Ok(Self { backend: Backend::cpu() })
    }

    /// A Vulkan device. The test fails if any work falls back to the CPU.
    fn vulkan() -> Result<Self, &'static VulkanError> {
        Ok(Self { backend: common::device::shared()? })
    }

    /// Default settings of the tests on this backend.
    fn sampling(&self) -> Sampling {
        let mut sampling = common::sampling();
        sampling.resources.backend = self.backend.clone();
        sampling
    }
}

/// Defines a test for each pair of a listed function and a backend.
macro_rules! on_every_backend {
    ($($module:ident: $($test:ident)*;)*) => {
        on_every_backend! { cpu: $($module: $($test)*;)* }
        on_every_backend! { vulkan: $($module: $($test)*;)* }
    };
    ($backend:ident: $($module:ident: $($test:ident)*;)*) => {
        mod $backend {
            $(mod $module {
                $(#[test]
                fn $test() {
                    match super::super::TestBackend::$backend() {
                        Ok(backend) => super::super::$module::$test(&backend),
                        Err(why) => super::super::common::device::skip(why),
                    }
                })*
            })*
        }
    };
}

on_every_backend! {
    oracle:
        the_sparse_field_equals_the_dense_field
        the_mesh_equals_the_mesh_of_the_dense_field
        the_mesh_of_spray_equals_the_mesh_of_the_dense_field
        the_mesh_is_independent_of_threads_particle_order_and_brick_side
        the_integer_field_and_its_vertices_approximate_the_method_in_f64
        moving_a_scene_by_whole_bins_moves_its_field
        changing_cell_size_and_origin_scales_and_moves_the_mesh;
    periodic:
        a_periodic_mesh_equals_the_mesh_of_repeated_particles
        the_surface_of_a_full_periodic_box_is_its_faces
        a_periodic_mesh_is_the_same_on_every_backend
        wrapped_particles_give_the_same_mesh_on_every_backend;
    sampled:
        the_plateau_of_sampled_blocks_equals_that_of_the_whole_pool;
    surfaces:
        known_shapes_have_their_genus_and_volume
        the_normals_of_a_sphere_point_outwards
        the_surface_of_white_noise_over_27_blocks_is_a_closed_manifold
        all_pairs_of_adjacent_sign_patterns_give_a_closed_manifold
        clouds_keep_drops_and_sheets_whole_without_changing_the_pool
        a_ball_of_radius_5_spacings_has_the_volume_of_its_particles
        an_air_bubble_of_radius_2_spacings_survives
        air_bubbles_of_radius_2_spacings_survive_deep_in_water
        the_roughness_of_a_pool_is_independent_of_the_cell_size
        wider_smoothing_makes_a_pool_calmer_without_moving_its_level
        a_tank_in_fine_cells_ends_at_its_walls_for_any_wide_cell_offset
        splashes_are_watertight_for_all_indicators_filters_and_walls
        a_half_full_tank_ends_exactly_at_its_walls_and_keeps_its_volume
        the_surface_of_a_full_tank_is_its_walls
        memory_does_not_depend_on_the_distance_between_drops
        a_lone_particle_is_a_closed_drop_unless_the_isovalue_is_too_high
        a_million_coincident_particles_become_one_drop_or_an_error
        attributes_are_interpolated_smoothly_for_any_particle_order;
}
