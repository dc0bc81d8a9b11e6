//! Tests of the checks of a mesh: defects with their positions, measures, and distances from
//! another mesh.

use meniscus::internals::surface::mesh::Mesh;
use meniscus::internals::surface::mesh::check::{Defects, check};
use meniscus::internals::surface::mesh::compare::{CompareError, SearchableSurface, Side, compare};
use meniscus::internals::surface::mesh::measure::measure;

use crate::common::shapes::{cone, cuboid, moved, sphere, torus, union};

fn once<T>(place: T) -> Defects<T> {
    Defects { count: 1, first: Some(place) }
}

/// Two cones that share their apex and are open at their rims.
fn cones_with_shared_apex() -> Mesh {
    let rim = [[1., 0., 1.], [0., 1., 1.], [-1., 0., 1.], [0., -1., 1.]];
    let mut mesh = cone(&rim, [0.; 3]);
    mesh.positions.extend(rim.map(|p| p.map(|x| -x)));
    mesh.triangles.extend((0..4).map(|i| [5 + i, 5 + (i + 1) % 4, 4]));
    mesh
}

#[test]
fn closed_oriented_manifold_meshes_have_no_defects() {
    for mesh in [cuboid([0.; 3], [1.; 3]), sphere(1., 3), torus(20, 10), Mesh::default()] {
        let report = check(&mesh);
        assert!(report.is_closed_oriented_manifold(), "{report}");
        assert_eq!(report.topology.edges, mesh.triangles.len() * 3 / 2);
        assert!(report.topology.twin_triangles.is_none() && report.duplicate_positions.is_none());
        assert!(report.topology.unreferenced_vertices.is_none());
    }
}

#[test]
fn a_missing_triangle_is_reported_as_three_boundary_edges() {
    let mut mesh = cuboid([0.; 3], [1.; 3]);
    assert_eq!(mesh.triangles.remove(3), [4, 7, 6]);
    let report = check(&mesh);
    assert_eq!(report.topology.boundary_edges, Defects { count: 3, first: Some([4, 6]) });
    assert!(
        !report.topology.is_closed()
            && report.topology.is_oriented()
            && report.topology.is_manifold()
    );
}

#[test]
fn a_flipped_triangle_is_reported_as_three_misoriented_edges() {
    let mut mesh = cuboid([0.; 3], [1.; 3]);
    mesh.triangles[3].swap(1, 2);
    let report = check(&mesh);
    assert_eq!(report.topology.misoriented_edges, Defects { count: 3, first: Some([4, 6]) });
    assert!(
        report.topology.is_closed()
            && !report.topology.is_oriented()
            && report.topology.is_manifold()
    );
    assert!(!report.is_closed_oriented_manifold());
}

#[test]
fn a_duplicate_triangle_is_reported_in_either_orientation() {
    for turn in [0, 1] {
        let mut mesh = cuboid([0.; 3], [1.; 3]);
        mesh.triangles.push([[6, 4, 7], [7, 4, 6]][turn]);
        let report = check(&mesh);
        assert_eq!(report.topology.twin_triangles, once([4, 6, 7]));
        assert_eq!(report.topology.crowded_edges, Defects { count: 3, first: Some([4, 6]) });
        assert!(!report.topology.is_manifold());
    }
}

#[test]
fn the_shared_apex_of_two_cones_is_a_pinched_vertex() {
    let report = check(&cones_with_shared_apex());
    assert_eq!(report.topology.pinched_vertices, once(4));
    assert!(report.topology.crowded_edges.is_none() && !report.topology.is_manifold());
}

#[test]
fn two_spheres_that_share_a_vertex_are_closed_but_not_a_manifold() {
    let mut mesh = union(&sphere(1., 2), &moved(&sphere(1., 2), [2., 0., 0.]));
    let second = mesh.positions.len() as u32 / 2;
    // Merge the rightmost vertex of the first sphere, which is vertex 0, with the leftmost vertex
    // of the second sphere, which is its vertex 2.
    for vertex in mesh.triangles.iter_mut().flatten().filter(|v| **v == second + 2) {
        *vertex = 0;
    }
    let report = check(&mesh);
    assert!(
        report.topology.is_closed()
            && report.topology.is_oriented()
            && !report.topology.is_manifold()
    );
    assert_eq!(report.topology.pinched_vertices, once(0));
    assert_eq!(report.topology.unreferenced_vertices, once(second + 2));
    assert_eq!(report.duplicate_positions, once(second as usize + 2));
    assert_eq!(measure(&mesh).genus, None);
}

#[test]
fn an_edge_of_three_triangles_is_crowded() {
    let mut mesh = sphere(1., 1);
    let [a, b, _] = mesh.triangles[7];
    mesh.positions.push([3.; 3]);
    mesh.triangles.push([b, a, mesh.positions.len() as u32 - 1]);
    let report = check(&mesh);
    assert_eq!(report.topology.crowded_edges, once([a.min(b), a.max(b)]));
    assert_eq!(report.topology.boundary_edges.count, 2);
    assert!(
        report.topology.pinched_vertices.is_none() && report.topology.misoriented_edges.is_none()
    );
}

#[test]
fn invalid_triangles_are_reported_and_otherwise_ignored() {
    let mut mesh = cuboid([0.; 3], [1.; 3]);
    mesh.triangles.insert(2, [1, 5, 1]);
    mesh.triangles.push([0, 8, 8]);
    mesh.triangles.push([0, 1, u32::MAX]);
    let report = check(&mesh);
    assert_eq!(report.topology.degenerate_triangles, once(2));
    assert_eq!(report.topology.out_of_range, Defects { count: 2, first: Some(13) });
    assert!(
        report.topology.is_closed()
            && report.topology.is_oriented()
            && !report.topology.is_manifold()
    );
    assert_eq!(report.topology.edges, 18);
    assert_eq!(measure(&mesh).area, 6.0);
}

#[test]
fn non_finite_and_repeated_positions_are_reported() {
    let mut mesh = cuboid([0.; 3], [1.; 3]);
    mesh.positions[3][1] = f64::NAN;
    mesh.positions[6][0] = f64::NEG_INFINITY;
    mesh.positions.push(mesh.positions[1]);
    mesh.positions.push(mesh.positions[1]);
    mesh.positions.push([-0.0, 0., 0.]);
    let report = check(&mesh);
    assert_eq!(report.non_finite_positions, Defects { count: 2, first: Some(3) });
    assert_eq!(report.duplicate_positions, Defects { count: 2, first: Some(8) });
    assert_eq!(report.topology.unreferenced_vertices, Defects { count: 3, first: Some(8) });
    assert!(report.topology.is_closed_oriented_manifold() && !report.is_closed_oriented_manifold());
}

#[test]
fn a_report_lists_each_defect_on_its_own_line() {
    let mut mesh = cuboid([0.; 3], [1.; 3]);
    assert_eq!(
        check(&mesh).to_string(),
        "8 vertices, 18 edges, 12 triangles\nclosed: yes\noriented: yes\n2-manifold: yes\n"
    );
    mesh.triangles.pop();
    let text = check(&mesh).to_string();
    assert!(text.contains("closed: no\n"), "{text}");
    assert!(text.ends_with("edges with only one triangle: 3, the first [1, 5]\n"), "{text}");
    let json = serde_json::to_value(check(&mesh)).unwrap();
    assert_eq!(
        (&json["vertices"], &json["boundary_edges"]["first"]),
        (&8.into(), &serde_json::json!([1, 5]))
    );
}

#[test]
fn checks_and_measures_are_independent_of_the_number_of_threads() {
    let mut mesh = torus(400, 200);
    mesh.triangles.retain(|t| t[0] % 1009 != 1008);
    for triangle in mesh.triangles.iter_mut().step_by(997) {
        triangle.swap(0, 1);
    }
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| (check(&mesh), measure(&mesh)))
    };
    assert_eq!(on(1), on(3));
    assert!(on(1).0.topology.boundary_edges.count > 100);
}

#[test]
fn components_euler_characteristic_and_genus_match_the_shape() {
    let ball = sphere(1., 3);
    let ring = torus(30, 12);
    let two = union(&ring, &moved(&ring, [9., 0., 0.]));
    for (mesh, components, euler, genus) in
        [(&ball, 1, 2, 0), (&ring, 1, 0, 1), (&two, 2, 0, 2), (&union(&ball, &two), 3, 2, 2)]
    {
        let measures = measure(mesh);
        assert_eq!(
            (measures.components, measures.euler_characteristic, measures.genus),
            (components, euler, Some(genus))
        );
    }
}

#[test]
fn the_volume_of_a_box_is_exact_far_from_the_origin() {
    for origin in [[0.; 3], [1_000_003.015625, -1_000_033.046875, 999_983.]] {
        let mut mesh = moved(&cuboid([0.; 3], [0.5, 2., 3.25]), origin);
        assert_eq!(measure(&mesh).volume, Some(3.25));
        assert_eq!(measure(&mesh).area, 2. * (1. + 6.5 + 1.625));
        let high = [origin[0] + 0.5, origin[1] + 2., origin[2] + 3.25];
        assert_eq!(measure(&mesh).bounds, Some([origin, high]));
        mesh.triangles.iter_mut().for_each(|t| t.swap(0, 1));
        assert_eq!(measure(&mesh).volume, Some(-3.25));
    }
}

#[test]
fn the_volume_of_distant_components_is_exact() {
    let far = [3e9, -2e9, 1e9];
    let mut mesh = cuboid([0.; 3], [0.5, 2., 3.25]);
    let other = moved(&mesh, far);
    let first = mesh.positions.len() as u32;
    mesh.triangles.extend(other.triangles.iter().map(|corners| corners.map(|v| v + first)));
    mesh.positions.extend(other.positions);
    let measures = measure(&mesh);
    assert_eq!((measures.volume, measures.components), (Some(6.5), 2));
    assert_eq!(measures.area, 4. * (1. + 6.5 + 1.625));
}

#[test]
fn the_volume_and_area_of_a_sphere_approach_the_formulas() {
    let measures = measure(&sphere(2., 6));
    let (volume, area) = (32. / 3. * std::f64::consts::PI, 16. * std::f64::consts::PI);
    assert!((measures.volume.unwrap() / volume - 1.).abs() < 1e-3, "{measures:?}");
    assert!((measures.area / area - 1.).abs() < 1e-3, "{measures:?}");
}

#[test]
fn an_open_mesh_has_an_area_but_no_volume_and_no_genus() {
    let mut mesh = cuboid([0.; 3], [1.; 3]);
    mesh.triangles.pop();
    let measures = measure(&mesh);
    assert_eq!((measures.area, measures.volume, measures.genus), (5.5, None, None));
    assert_eq!(measures.euler_characteristic, 1);
}

#[test]
fn an_empty_mesh_has_no_box_and_no_worst_triangle() {
    let measures = measure(&Mesh::default());
    assert_eq!((measures.bounds, measures.area, measures.volume), (None, 0., Some(0.)));
    assert_eq!(
        (measures.components, measures.genus, measures.quality.mean_angle),
        (0, Some(0), None)
    );
}

#[test]
fn the_worst_triangle_is_reported_with_its_angle() {
    // Compare a regular octahedron, an octahedron with a needle, and one with a triangle of area 0.
    let octahedron = sphere(1., 0);
    let quality = measure(&octahedron).quality;
    assert!((quality.worst_angle.unwrap() - 60.).abs() < 1e-9);
    assert!((quality.worst_aspect.unwrap() - 1.).abs() < 1e-9);
    assert_eq!(quality.least_angles.iter().sum::<usize>(), 8);

    let mut mesh = Mesh { positions: vec![[0.; 3], [1., 0., 0.], [0., 1., 0.]], ..Mesh::default() };
    mesh.positions.push([1., 0.1, 0.]);
    mesh.positions.push([2., 0., 0.]);
    mesh.triangles = vec![[0, 1, 2], [0, 1, 3]];
    let quality = measure(&mesh).quality;
    assert_eq!(quality.worst_triangle, Some(1));
    assert!((quality.worst_angle.unwrap() - 0.1_f64.atan().to_degrees()).abs() < 1e-9);
    assert_eq!((quality.least_angles[1], quality.least_angles[9], quality.flat), (1, 1, 0));

    mesh.triangles.push([0, 1, 4]);
    let quality = measure(&mesh).quality;
    assert_eq!((quality.worst_triangle, quality.worst_angle, quality.flat), (Some(2), Some(0.), 1));
}

fn scaled(mesh: &Mesh, by: f64) -> Mesh {
    let mut mesh = mesh.clone();
    mesh.positions.iter_mut().flatten().for_each(|x| *x *= by);
    mesh
}

#[test]
fn the_distance_of_a_mesh_from_itself_is_zero() {
    for mesh in [cuboid([0.; 3], [1.; 3]), sphere(1., 3), torus(40, 20)] {
        let same = compare(&mesh, &mesh).unwrap();
        assert!(same.hausdorff < 1e-15 && same.bias.abs() < 1e-15, "{same:?}");
        assert_eq!(
            (same.from_mesh.samples, same.from_mesh.vertices),
            (100_000, mesh.positions.len())
        );
    }
}

#[test]
fn the_distance_of_an_offset_sphere_is_the_signed_offset() {
    let ball = sphere(1., 5);
    for offset in [0.01, -0.01] {
        let found = compare(&ball, &scaled(&ball, 1. + offset)).unwrap();
        // The triangles of the mesh are chords, up to 0.0006 inside the true sphere.
        assert!((found.hausdorff - 0.01).abs() < 1e-5, "{found:?}");
        assert!((found.bias - offset).abs() < 2e-5, "{found:?}");
        for way in [&found.from_mesh, &found.from_reference] {
            assert!((way.mean - 0.01).abs() < 2e-5 && way.rms >= way.mean, "{found:?}");
        }
    }
}

#[test]
fn distances_are_the_same_far_from_the_origin() {
    let (ball, larger) = (sphere(1., 4), sphere(1.25, 4));
    let by = [1e6, -2e6, 4e6];
    let near = compare(&ball, &larger).unwrap();
    let far = compare(&moved(&ball, by), &moved(&larger, by)).unwrap();
    assert!((near.hausdorff - far.hausdorff).abs() < 1e-8 && (near.bias - far.bias).abs() < 1e-8);
    assert!((far.from_mesh.farthest[2] - by[2]).abs() < 1.3);
}

#[test]
fn the_greatest_distance_is_reported_for_the_mesh_that_has_it() {
    // A spike on the mesh is far from the reference, although the reference is near the mesh.
    let reference = sphere(1., 3);
    let mut mesh = reference.clone();
    mesh.positions[0] = [3., 0., 0.];
    let found = compare(&reference, &mesh).unwrap();
    assert_eq!(found.from_mesh.max, 2.);
    assert_eq!(found.from_mesh.farthest, [3., 0., 0.]);
    assert!(found.from_reference.max < 0.2 && found.hausdorff == 2.);
}

#[test]
fn signs_are_right_if_the_nearest_point_is_on_an_edge_or_a_corner() {
    // For most points of a large sphere, the nearest point of a small box is a corner.
    let small = cuboid([-0.1; 3], [0.1, 0.1, 0.3]);
    let found = compare(&small, &sphere(2., 2)).unwrap();
    assert!((found.bias - found.from_mesh.mean).abs() < 1e-12, "{found:?}");
    // A small box lies inside a large notched box, close to the edge of the notch.
    let notch = [[0., 0., 0.], [4., 0., 0.], [4., 4., 0.], [2., 0.5, 0.], [0., 4., 0.]];
    let found = compare(&prism(&notch, 8.), &cuboid([1.8, 0.2, 3.], [2.2, 0.3, 5.])).unwrap();
    assert!((found.bias + found.from_mesh.mean).abs() < 1e-12, "{found:?}");
}

#[test]
fn signs_are_independent_of_the_triangulation_around_a_corner() {
    // A spike along x with slivers on one side. The slivers would pull the normal of the tip to
    // their side if normals were not weighted by angles.
    let quarter = std::f64::consts::FRAC_PI_2;
    let angles =
        (0..40).map(|i| quarter * f64::from(i) / 40.).chain([1., 2., 3.].map(|i| quarter * i));
    let rim: Vec<[f64; 3]> = angles.map(|a| [0., 0.05 * a.cos(), 0.05 * a.sin()]).collect();
    let mut spike = cone(&rim, [1., 0., 0.]);
    let base = spike.positions.len() as u32;
    spike.positions.push([0.; 3]);
    let below: Vec<_> = spike.triangles.iter().map(|&[a, b, _]| [b, a, base]).collect();
    spike.triangles.extend(below);
    assert!(check(&spike).is_closed_oriented_manifold());
    let found = compare(&spike, &cuboid([1.1, -0.6, -0.6], [1.2, -0.5, -0.5])).unwrap();
    assert!((found.bias - found.from_mesh.mean).abs() < 1e-12, "{found:?}");
}

/// Extrudes an outline along z. The outline must be counter-clockwise, and star-shaped with respect
/// to its fourth corner.
fn prism(outline: &[[f64; 3]], height: f64) -> Mesh {
    let n = outline.len() as u32;
    let mut mesh = Mesh { positions: outline.to_vec(), ..Mesh::default() };
    mesh.positions.extend(outline.iter().map(|p| [p[0], p[1], height]));
    for i in 0..n {
        let j = (i + 1) % n;
        mesh.triangles.extend([[i, j, n + j], [i, n + j, n + i]]);
        if i != 3 && j != 3 {
            mesh.triangles.extend([[3, j, i], [n + 3, n + i, n + j]]);
        }
    }
    assert!(check(&mesh).is_closed_oriented_manifold(), "{}", check(&mesh));
    mesh
}

#[test]
fn a_vertex_of_many_triangles_does_not_slow_distance_queries() {
    let corners = 20_000;
    let rim: Vec<[f64; 3]> = (0..corners)
        .map(|i| f64::from(i) / f64::from(corners) * std::f64::consts::TAU)
        .map(|angle| [angle.cos(), angle.sin(), -1.0])
        .collect();
    let cone = cone(&rim, [0.0; 3]);
    let surface = SearchableSurface::reference(&cone).unwrap();
    // All these points have the same nearest point: the tip.
    let places: Vec<_> = (0..100_000).map(|i| [0.0, 0.0, 1.0 + f64::from(i)]).collect();
    let begun = std::time::Instant::now();
    let distances = surface.signed_distances(&places);
    let seconds = begun.elapsed().as_secs_f64();
    assert!(distances.iter().zip(&places).all(|(distance, place)| *distance == place[2]));
    // This would take about 20 s if every query tested all triangles around the tip.
    assert!(seconds < 5.0, "{seconds} s");
}

#[test]
fn comparisons_are_independent_of_the_number_of_threads() {
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| compare(&torus(50, 20), &torus(43, 27))).unwrap()
    };
    assert_eq!(on(1), on(3));
}

#[test]
fn one_triangle_can_be_compared_to_another() {
    let flat = |z| Mesh {
        positions: vec![[0., 0., z], [1., 0., z], [0., 1., z]],
        triangles: vec![[0, 1, 2]],
        ..Mesh::default()
    };
    let found = compare(&flat(0.), &flat(-0.25)).unwrap();
    assert_eq!((found.hausdorff, found.bias, found.from_reference.rms), (0.25, -0.25, 0.25));
}

#[test]
fn meshes_without_a_surface_cannot_be_compared() {
    let ball = sphere(1., 1);
    let empty = Mesh { positions: ball.positions.clone(), ..Mesh::default() };
    assert_eq!(compare(&empty, &ball), Err(CompareError::NoSurface(Side::Reference)));
    assert_eq!(compare(&ball, &scaled(&ball, 0.)), Err(CompareError::NoSurface(Side::Mesh)));
    for x in [f64::NAN, f64::INFINITY, 1e100] {
        let mut bad = ball.clone();
        bad.positions[5][1] = x;
        assert_eq!(
            compare(&ball, &bad),
            Err(CompareError::NotFinite { side: Side::Mesh, vertex: 5 })
        );
        bad.triangles.retain(|t| !t.contains(&5));
        assert!(compare(&ball, &bad).is_ok());
    }
}
