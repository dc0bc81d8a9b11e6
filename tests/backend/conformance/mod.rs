//! The conformance tests of every backend: results equal to the method's to the bit, and watertight
//! surfaces with the right topology.

mod oracle;
mod periodic;
mod sampled;
mod surfaces;

use std::convert::Infallible;

use meniscus::internals::backend::Backend;
use meniscus::internals::frame::Sampling;
use meniscus::internals::vulkan::VulkanError;

use crate::common;

/// The backend on which the tests run.
struct Place {
    backend: Backend,
}

impl Place {
    fn cpu() -> Result<Self, Infallible> {
        Ok(Self { backend: Backend::cpu() })
    }

    /// A watched device: work that falls back to the CPU fails the test.
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

/// Makes a test of the list for each backend.
macro_rules! at_every_place {
    ($($module:ident: $($test:ident)*;)*) => {
        at_every_place! { cpu: $($module: $($test)*;)* }
        at_every_place! { vulkan: $($module: $($test)*;)* }
    };
    ($place:ident: $($module:ident: $($test:ident)*;)*) => {
        mod $place {
            $(mod $module {
                $(#[test]
                fn $test() {
                    match super::super::Place::$place() {
                        Ok(place) => super::super::$module::$test(&place),
                        Err(why) => super::super::common::device::skip(why),
                    }
                })*
            })*
        }
    };
}

at_every_place! {
    oracle:
        the_sparse_field_is_the_dense_one_to_the_bit
        the_mesh_is_that_of_the_dense_field_vertex_by_vertex
        the_mesh_of_spray_is_that_of_the_dense_field
        threads_particle_order_and_brick_side_change_no_byte
        the_integer_field_and_its_vertices_stay_close_to_the_method_in_f64
        a_scene_moved_by_whole_bins_has_its_field_moved_by_as_much
        cells_of_any_size_at_any_origin_give_the_mesh_of_unit_cells_scaled_and_moved;
    periodic:
        the_mesh_in_a_periodic_box_is_that_of_the_fluid_repeated
        a_box_full_of_fluid_has_its_faces_for_a_surface_however_deep_the_fluid_is
        a_periodic_mesh_is_the_same_on_every_backend;
    sampled:
        the_plateau_that_some_blocks_tell_is_that_of_the_whole_pool;
    surfaces:
        sphere_slab_and_torus_have_their_genus_and_their_volume_within_one_percent_at_32_cells
        normals_point_out_of_a_sphere
        white_noise_over_27_blocks_is_a_closed_oriented_manifold
        every_combination_of_signs_beside_every_other_is_a_closed_oriented_manifold
        clouds_keep_every_drop_and_a_sheet_whole_and_leave_a_pool_as_it_is
        a_ball_of_five_spacings_holds_the_volume_of_its_particles
        a_ball_of_air_of_two_spacings_is_left_in_the_water
        air_of_two_spacings_is_left_wherever_it_lies_deep_in_water
        a_pool_is_as_level_in_fine_cells_as_in_coarse_ones
        a_pool_is_calmer_the_wider_it_is_smoothed_and_as_high
        a_tank_in_fine_cells_ends_on_its_walls_wherever_wide_cells_lie_against_them
        splashes_are_watertight_with_every_indicator_filter_and_wall
        a_half_full_tank_ends_exactly_on_its_walls_and_keeps_its_volume
        a_full_tank_has_its_walls_for_a_surface_where_no_block_holds_anything_else
        two_drops_a_million_cells_apart_cost_two_drops_and_keep_their_shape
        a_lone_particle_gives_a_closed_drop_and_an_isovalue_above_its_peak_an_error
        a_million_particles_in_one_place_are_one_drop
        attributes_reach_the_vertices_blurred_like_the_field;
}
