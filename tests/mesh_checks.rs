//! What can be said of a mesh: defects by name and place, measures, and distances.

mod common {
    pub mod shapes;
}

use common::shapes::{cone, cuboid, moved, sphere, torus, union};
use meniscus::mesh::Mesh;
use meniscus::mesh::check::{Found, check};
use meniscus::mesh::measure::measure;

fn once<T>(place: T) -> Found<T> {
    Found { count: 1, first: Some(place) }
}

/// Two cones tip to tip: closed as long as nobody asks for their rims.
fn cones_on_one_apex() -> Mesh {
    let rim = [[1., 0., 1.], [0., 1., 1.], [-1., 0., 1.], [0., -1., 1.]];
    let mut mesh = cone(&rim, [0.; 3]);
    mesh.positions.extend(rim.map(|p| p.map(|x| -x)));
    mesh.triangles.extend((0..4).map(|i| [5 + i, 5 + (i + 1) % 4, 4]));
    mesh
}

#[test]
fn good_meshes_have_no_defect() {
    for mesh in [cuboid([0.; 3], [1.; 3]), sphere(1., 3), torus(20, 10), Mesh::default()] {
        let report = check(&mesh);
        assert!(report.is_closed_oriented_manifold(), "{report}");
        assert_eq!(report.topology.edges, mesh.triangles.len() * 3 / 2);
        assert!(report.topology.twin_triangles.is_none() && report.duplicate_positions.is_none());
        assert!(report.topology.unreferenced_vertices.is_none());
    }
}

#[test]
fn a_hole_is_found_by_its_three_edges() {
    let mut mesh = cuboid([0.; 3], [1.; 3]);
    assert_eq!(mesh.triangles.remove(3), [4, 7, 6]);
    let report = check(&mesh);
    assert_eq!(report.topology.boundary_edges, Found { count: 3, first: Some([4, 6]) });
    assert!(!report.topology.is_closed() && report.topology.is_oriented() && report.topology.is_manifold());
}

#[test]
fn a_flipped_triangle_is_found_by_its_three_edges() {
    let mut mesh = cuboid([0.; 3], [1.; 3]);
    mesh.triangles[3].swap(1, 2);
    let report = check(&mesh);
    assert_eq!(report.topology.misoriented_edges, Found { count: 3, first: Some([4, 6]) });
    assert!(report.topology.is_closed() && !report.topology.is_oriented() && report.topology.is_manifold());
    assert!(!report.is_closed_oriented_manifold());
}

#[test]
fn a_triangle_given_twice_is_found_whichever_way_round() {
    for turn in [0, 1] {
        let mut mesh = cuboid([0.; 3], [1.; 3]);
        mesh.triangles.push([[6, 4, 7], [7, 4, 6]][turn]);
        let report = check(&mesh);
        assert_eq!(report.topology.twin_triangles, once([4, 6, 7]));
        assert_eq!(report.topology.crowded_edges, Found { count: 3, first: Some([4, 6]) });
        assert!(!report.topology.is_manifold());
    }
}

#[test]
fn two_cones_that_share_their_apex_are_pinched_there() {
    let report = check(&cones_on_one_apex());
    assert_eq!(report.topology.pinched_vertices, once(4));
    assert!(report.topology.crowded_edges.is_none() && !report.topology.is_manifold());
}

#[test]
fn two_spheres_that_share_a_vertex_are_closed_but_no_manifold() {
    let mut mesh = union(&sphere(1., 2), &moved(&sphere(1., 2), [2., 0., 0.]));
    let second = mesh.positions.len() as u32 / 2;
    // Vertex 0 of the first is the rightmost one, vertex 2 of the second the leftmost.
    for vertex in mesh.triangles.iter_mut().flatten().filter(|v| **v == second + 2) {
        *vertex = 0;
    }
    let report = check(&mesh);
    assert!(report.topology.is_closed() && report.topology.is_oriented() && !report.topology.is_manifold());
    assert_eq!(report.topology.pinched_vertices, once(0));
    assert_eq!(report.topology.unreferenced_vertices, once(second + 2));
    assert_eq!(report.duplicate_positions, once(second as usize + 2));
    assert_eq!(measure(&mesh).genus, None);
}

#[test]
fn three_triangles_at_an_edge_are_crowded() {
    let mut mesh = sphere(1., 1);
    let [a, b, _] = mesh.triangles[7];
    mesh.positions.push([3.; 3]);
    mesh.triangles.push([b, a, mesh.positions.len() as u32 - 1]);
    let report = check(&mesh);
    assert_eq!(report.topology.crowded_edges, once([a.min(b), a.max(b)]));
    assert_eq!(report.topology.boundary_edges.count, 2);
    assert!(report.topology.pinched_vertices.is_none() && report.topology.misoriented_edges.is_none());
}

#[test]
fn unsound_triangles_are_named_and_hide_nothing_else() {
    let mut mesh = cuboid([0.; 3], [1.; 3]);
    mesh.triangles.insert(2, [1, 5, 1]);
    mesh.triangles.push([0, 8, 8]);
    mesh.triangles.push([0, 1, u32::MAX]);
    let report = check(&mesh);
    assert_eq!(report.topology.degenerate_triangles, once(2));
    assert_eq!(report.topology.out_of_range, Found { count: 2, first: Some(13) });
    assert!(report.topology.is_closed() && report.topology.is_oriented() && !report.topology.is_manifold());
    assert_eq!(report.topology.edges, 18);
    assert_eq!(measure(&mesh).area, 6.0);
}

#[test]
fn positions_that_are_no_points_and_those_given_twice_are_named() {
    let mut mesh = cuboid([0.; 3], [1.; 3]);
    mesh.positions[3][1] = f64::NAN;
    mesh.positions[6][0] = f64::NEG_INFINITY;
    mesh.positions.push(mesh.positions[1]);
    mesh.positions.push(mesh.positions[1]);
    mesh.positions.push([-0.0, 0., 0.]);
    let report = check(&mesh);
    assert_eq!(report.non_finite_positions, Found { count: 2, first: Some(3) });
    assert_eq!(report.duplicate_positions, Found { count: 2, first: Some(8) });
    assert_eq!(report.topology.unreferenced_vertices, Found { count: 3, first: Some(8) });
    assert!(report.topology.is_closed_oriented_manifold() && !report.is_closed_oriented_manifold());
}

#[test]
fn a_report_reads_as_lines_that_name_the_defect() {
    let mut mesh = cuboid([0.; 3], [1.; 3]);
    assert_eq!(
        check(&mesh).to_string(),
        "8 vertices, 18 edges, 12 triangles\nclosed: yes\noriented: yes\n2-manifold: yes\n"
    );
    mesh.triangles.pop();
    let text = check(&mesh).to_string();
    assert!(text.contains("closed: no\n"), "{text}");
    assert!(text.ends_with("edges with one triangle only: 3, the first [1, 5]\n"), "{text}");
}

#[test]
fn findings_do_not_depend_on_the_number_of_threads() {
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
fn genus_and_components_are_those_of_the_shape() {
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
fn a_box_has_its_exact_volume_wherever_it_lies() {
    for origin in [[0.; 3], [1e6, -1e6, 1e6]] {
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
fn a_sphere_has_about_the_volume_and_area_of_a_ball() {
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
    assert_eq!((measures.components, measures.genus, measures.quality.mean_angle), (0, Some(0), None));
}

#[test]
fn the_worst_triangle_is_named_with_its_angle() {
    // A regular octahedron, then one with a needle, then one with a triangle of no area.
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
