//! Tests of finding the columns of text tables: names in any notation give the columns, and a table
//! whose columns are unclear is refused.

use meniscus::internals::io::bytes::Unpacking;
use meniscus::internals::io::input::InputFormat;
use meniscus::internals::io::text_format::{self, TextHint};
use meniscus::internals::io::wanted::WantedAttributes;
use meniscus::internals::io::{ParticleFile, ReadFault, UnreadPart};
use meniscus::internals::particles::Particles;
use meniscus::internals::particles::condition::Where;
use meniscus::internals::particles::sizes::SizeChoice;

use crate::common::particle_files::{attribute, positions};

/// Rows of two particles: the velocity, then the position.
const VELOCITY_FIRST: &str = "0.5 0.25 -0.5 1.5 2.5 3.5\n0.75 0.5 0.25 4.5 5.5 6.5\n";
const VELOCITIES: [f32; 6] = [0.5, 0.25, -0.5, 0.75, 0.5, 0.25];
const POSITIONS: [[f64; 3]; 2] = [[1.5, 2.5, 3.5], [4.5, 5.5, 6.5]];

fn read_as(format: InputFormat, table: &str) -> Result<ParticleFile, ReadFault> {
    let hint = TextHint::Extension(Some(format));
    let bytes = table.as_bytes().to_vec().into();
    let all = WantedAttributes::All;
    text_format::read_particles(bytes, hint, (None, None), all, Unpacking::in_memory())
}

fn text(table: &str) -> Result<ParticleFile, ReadFault> {
    read_as(InputFormat::Csv, table)
}

/// The line and the description of a table's error.
fn refusal(table: &str) -> (u64, String) {
    match text(table) {
        Err(ReadFault::Line { line, what }) => (line, what),
        other => panic!("{table:?}: {other:?}"),
    }
}

fn attributes(file: &ParticleFile) -> Vec<(&str, usize)> {
    file.particles.attributes().iter().map(|info| (info.name.as_str(), info.components)).collect()
}

fn table(rows: usize, row: impl Fn(usize) -> String) -> String {
    (0..rows).map(|number| row(number) + "\n").collect()
}

/// Three coordinates that are not whole numbers.
fn place(row: usize) -> String {
    let coordinate = |number: usize| format!("{:.3}", (number * 37 % 101) as f64 / 102.0 + 0.005);
    format!("{} {} {}", coordinate(row), coordinate(row + 5), coordinate(row + 9))
}

/// Coordinates in a lattice that is sorted by x, then by y, then by z. `y` and `z` are the numbers
/// of particles along these axes.
fn lattice(row: usize, [y, z]: [usize; 2]) -> String {
    let along = [row / (y * z), row / z % y, row % z].map(|cell| 0.05 * cell as f64 + 0.025);
    format!("{:.3} {:.3} {:.3}", along[0], along[1], along[2])
}

/// The numbers in the columns from `first` on.
fn three_columns(table: &str, first: usize) -> Vec<[f64; 3]> {
    let row = |line: &str| {
        let numbers: Vec<f64> = line.split(' ').map(|word| word.parse().unwrap()).collect();
        [0, 1, 2].map(|axis| numbers[first + axis])
    };
    table.lines().map(row).collect()
}

#[test]
fn unnamed_columns_of_identifiers_and_types_are_refused() {
    let vectors = |i: usize| format!("{} {}", place(i), place(i + 1)).replace(' ', "\t");
    let gpusph = table(3, |i| format!("{i}\t0\t0\t{}\t0.125\t1000\t0\t", vectors(i)));
    let cases = [
        (table(3, |i| format!("{i} 1 {}", place(i))), "columns 1 and 2", "`id type x y z`"),
        (table(2, |i| format!("{i} 1 {}", place(i))), "columns 1 and 2", "`id type x y z`"),
        (
            table(9, |i| format!("{i} {} {} {}", i % 2, place(i), place(i + 1))),
            "columns 1 and 2",
            "`id type x y z ...`",
        ),
        (gpusph, "columns 1, 2 and 3", "`id type object x y z ...`"),
        (table(9, |i| format!("{i} -1 {}", place(i))), "columns 1 and 2", "`id type x y z`"),
        (table(9, |i| format!("2 {} {}", 90 - i, place(i))), "columns 1 and 2", "`type id x y z`"),
        (
            table(9, |i| format!("{} 0 {}", i % 2, place(i))),
            "columns 1 and 2",
            "`type object x y z`",
        ),
        (
            table(20, |i| format!("{:.3e} 1.000e0 {}", i as f64, place(i))),
            "columns 1 and 2",
            "`id type x y z`",
        ),
        (
            table(9, |i| format!("{i} 1 {}", place(i))).replace(' ', ";").replace('.', ","),
            "columns 1 and 2",
            "`id type x y z`",
        ),
        (table(20, |i| format!("{} {}", i % 3, place(i))), "column 1", "`type x y z`"),
        (table(9, |i| format!("{i} {} 0", &place(i)[..11])), "column 1", "`id x y z`"),
        (table(20, |i| format!("{} {} 0", i * 7 % 23, &place(i)[..11])), "column 1", "`id x y z`"),
        (table(20, |i| format!("0.125 {i} {}", place(i))), "column 2", "`mass id x y z`"),
        (
            table(300, |i| format!("{i} {} {} {}", i % 10, i / 10 % 10, i / 100)),
            "column 1",
            "`id x y z`",
        ),
        (table(3, |i| format!("water {i} 1 {}", place(i))), "columns 2 and 3", "`name id type x"),
        (table(16, |i| format!("1 {}", place(i))), "column 1", "`type x y z`"),
        (table(16, |i| format!("0.000 {}", place(i))), "column 1", "`type x y z`"),
        (table(16, |i| format!("0.125 {}", place(i))), "column 1", "`mass x y z`"),
        (table(16, |i| format!("water 1 {}", place(i))), "column 2", "`name type x y z`"),
        (table(20, |i| format!("1 {} water", place(i))), "column 1", "`type x y z ...`"),
        (table(20, |i| format!("1 {} {}", place(i), place(i + 1))), "column 1", "`type x y z ...`"),
        // If a lattice's type, x and y were read as the position, particles would coincide.
        (table(300, |i| format!("1 {}", lattice(i, [10, 6]))), "column 1", "`type x y z`"),
        (
            table(300, |i| format!("1 {} 0.5 0 0", lattice(i, [10, 6]))),
            "column 1",
            "`type x y z ...`",
        ),
        (table(300, |i| format!("1 {}", lattice(i, [10, 30]))), "column 1", "`type x y z`"),
    ];
    for (table, columns, header) in cases {
        let (line, what) = refusal(&format!("# t = 0.1\n{table}"));
        assert_eq!(line, 2, "{what}");
        assert!(what.contains(columns) && what.contains(header), "{table}: {what}");
    }
}

#[test]
fn an_example_of_a_header_in_an_error_makes_the_table_readable() {
    let rows = table(5, |i| format!("{i} 1 {}", place(i)));
    let (_, what) = refusal(&rows);
    let header = what.split('`').nth(1).unwrap();
    let file = text(&format!("{header}\n{rows}")).unwrap();
    assert_eq!(positions(&file), three_columns(&rows, 2));
    assert_eq!(attributes(&file), [("id", 1), ("type", 1)]);
}

#[test]
fn a_single_identifier_before_real_coordinates_is_skipped() {
    for rows in [
        table(3, |i| format!("{i} {}", place(i))),
        table(3, |i| format!("{} {} {}", 90 - i, place(i), place(i + 1))),
        table(20, |i| format!("{} {}", i * 7 % 23, place(i))),
        table(20, |i| format!("{:.3e} {}", i as f64, place(i))),
        table(20, |i| format!("{} {}", (1 << 62) + i, place(i))),
        table(27, |i| format!("{i} {}.0 {}.0 {}.0", i % 3, i / 3 % 3, i / 9)),
    ] {
        assert_eq!(positions(&text(&rows).expect(&rows)), three_columns(&rows, 1), "{rows}");
    }
}

#[test]
fn whole_coordinates_of_lattices_and_planes_are_not_taken_for_types() {
    let whole = |i: usize| format!("{} {} {}", i % 10, i / 10 % 10, i / 100);
    let reverse = |i: usize| format!("{} {} {}", i / 100, i / 10 % 10, i % 10);
    for rows in [
        table(300, whole),
        table(300, |i| format!("{i} 0 0")),
        table(300, |i| format!("{} 1 0.5", whole(i))),
        table(300, |i| format!("0.0 0.0 {} {}", 0.05 * (i + 1) as f64, place(i))),
        table(300, |i| format!("{} {}", whole(i), place(i))),
        table(300, |i| format!("{} {}", reverse(i), place(i))),
        table(20, |i| format!("0 {}", &place(i)[..11])),
        table(20, |i| format!("0 {} {}", &place(i)[..11], place(i + 1))),
        table(20, |i| format!("0 {} 0 {}", &place(i)[..11], &place(i + 1)[..11])),
        table(20, |i| format!("1.0 {} {}", &place(i)[..11], place(i + 1))),
        table(20, |i| format!("{} 0 {}", &place(i)[..11], place(i + 1))),
        // Particles in planes at several whole numbers of x.
        table(8, |i| format!("{} {} {}", i % 2, &place(i)[..11], place(i + 1))),
        table(60, |i| format!("{} {} {} {}", i % 3, (i / 3) as f64 / 2.0, i % 5, place(i))),
        // A column of water at x = 0 and y = 0, whose pressure depends on the depth.
        table(300, |i| format!("0 0 {} 0 0 0 1000 {}", i as f64 / 20.0, 9.81 * (300 - i) as f64)),
        // Coordinates in micrometres.
        table(300, |i| {
            let coordinate = |factor: usize| i * factor % 1_000_003;
            format!("{} {} {} {}", coordinate(7919), coordinate(104_729), coordinate(31), place(i))
        }),
        table(20, |i| format!("{} {}", place(i), i % 2)),
        table(20, |i| format!("{} {i}", place(i))),
        table(20, |i| format!("{} 0.125", place(i))),
        table(20, |i| format!("0 {} 0.125", &place(i)[..11])),
        // The first plane of a lattice, with the pressure.
        table(300, |i| format!("{} {}", lattice(i, [20, 15]), 9.81 * (300 - i) as f64)),
    ] {
        assert_eq!(positions(&text(&rows).expect(&rows)), three_columns(&rows, 0), "{rows}");
    }
}

#[test]
fn names_in_a_comment_are_understood_in_every_notation() {
    for names in [
        "# vx[m/s] vy[m/s] vz[m/s] x[m] y[m] z[m]",
        "# vx[m/s], vy[m/s], vz[m/s], x[m], y[m], z[m]",
        "# vx (m/s)   vy (m/s) vz (m/s) x (m) y (m) z (m)",
        "# vx (m / s) vy (m / s) vz (m / s) x (m) y (m) z (m)",
        "# 1:vx 2:vy 3:vz 4:x 5:y 6:z",
        "# [0] vx [1] vy [2] vz [3] x [4] y [5] z",
        "# (1) vx, (2) vy, (3) vz, (4) x, (5) y, (6) z",
        "# 1 vx 2 vy 3 vz 4 x 5 y 6 z",
        "# 1: vx [m/s] 2: vy [m/s] 3: vz [m/s] 4: x [m] 5: y [m] 6: z [m]",
        "# [0] vx\n# [1] vy\n# [2] vz\n# [3] x\n# [4] y\n# [5] z",
        "# SPH\n# column 1: vx\n# column 2: vy\n# column 3: vz\n# column 4: x\n# column 5: y\n\
         # column 6: z\n# ---",
        "# 1 = vx [m/s]\n# 2 = vy [m/s]\n# 3 = vz [m/s]\n# 4 = x [m]\n# 5 = y [m]\n# 6 = z [m]",
        "# 1: vx of it\n# 2: vy of it\n# 3: vz of it\n# 4: x of it\n# 5: y of it\n# 6: z of it",
        "# columns: vx vy vz x y z",
        "# t = 0.1, columns: vx, vy, vz, x, y, z",
        "# fields=vx,vy,vz,x,y,z",
        "# vx vy vz x y z\n# [m/s] [m/s] [m/s] [m] [m] [m]",
        "vx[m/s] vy[m/s] vz[m/s] x[m] y[m] z[m]",
        "vx (m/s)   vy (m/s)  vz (m/s)  x (m)  y (m)  z (m)",
        "1:vx 2:vy 3:vz 4:x 5:y 6:z",
        "# vx[1] vy[2] vz[3] x[4] y[5] z[6]",
        "vx(0), vy(1), vz(2), x(3), y(4), z(5)",
        "# vx [1] vy [2] vz [3] x [4] y [5] z [6]",
        "vx:1 vy:2 vz:3 x:4 y:5 z:6",
        "% vx{1} vy{2} vz{3} x{4} y{5} z{6}",
        "// vx=1 vy=2 vz=3 x=4 y=5 z=6",
        "#1 vx #2 vy #3 vz #4 x #5 y #6 z",
        "# v[1] v[2] v[3] x[4] x[5] x[6]",
        "! v (1-3), x (4-6)",
        "# v(3), x(3)",
        "v[3] x[3]",
        "v x",
        "# v r",
        "v p",
        "v,p",
        "# vx vy vz xu yu zu",
        "# vx/(m/s) vy/(m/s) vz/(m/s) X/m Y/m Z/m",
        "v pos",
        "# v, positions",
        "v,x,y,z",
        "# v pos [m]",
        "# data: v pos",
    ] {
        let file = text(&format!("{names}\n{VELOCITY_FIRST}")).expect(names);
        assert_eq!(positions(&file), POSITIONS, "{names}");
        assert_eq!(attributes(&file), [("v", 3)], "{names}");
        assert_eq!(attribute(&file, "v"), VELOCITIES, "{names}");
    }
    let rows = table(3, |i| format!("{i} 1 {}", place(i)));
    for names in ["# time 0.1\n# 1:id 2:type 3:x 4:y 5:z", "# columns: id, type, x, y, z"] {
        let file = text(&format!("{names}\n{rows}")).expect(names);
        assert_eq!(positions(&file), three_columns(&rows, 2), "{names}");
        assert_eq!(attributes(&file), [("id", 1), ("type", 1)], "{names}");
    }
}

#[test]
fn names_of_vectors_stand_for_three_columns_if_the_number_of_columns_fits() {
    let rows = "7 0.5 0.25 -0.5 1.5 2.5 3.5\n8 0.75 0.5 0.25 4.5 5.5 6.5\n";
    for names in [
        "rho velocity position",
        "rho, velocity, position",
        "# rho velocity(3) position(3)",
        "# rho, velocity[3], position[3]",
        "# rho (1), velocity (2-4), position (5-7)",
        "# rho velocity x y z",
        "\"rho\" \"velocity\" \"coordinates\"",
        "# rho velocity position\n1920",
    ] {
        let file = text(&format!("{names}\n{rows}")).expect(names);
        assert_eq!(positions(&file), POSITIONS, "{names}");
        assert_eq!(attributes(&file), [("rho", 1), ("velocity", 3)], "{names}");
        assert_eq!(attribute(&file, "velocity"), VELOCITIES, "{names}");
    }
}

#[test]
fn a_single_letter_stands_for_a_vector_only_if_the_number_of_columns_fits() {
    let rows = "1.5 2.5 3.5 0.5 0.25 -0.5\n4.5 5.5 6.5 0.75 0.5 0.25\n";
    for names in ["x v", "# x v", "p v", "r velocity", "x,vel"] {
        let file = text(&format!("{names}\n{rows}")).expect(names);
        assert_eq!(positions(&file), POSITIONS, "{names}");
        assert_eq!(attribute(&file, attributes(&file)[0].0), VELOCITIES, "{names}");
    }
    for names in ["u x", "velocity x", "# velocity r"] {
        let file = text(&format!("{names}\n{VELOCITY_FIRST}")).expect(names);
        assert_eq!((positions(&file), attributes(&file).len()), (POSITIONS.to_vec(), 1), "{names}");
    }
    let rows = "1.5 2.5 3.5 10 1000\n4.5 5.5 6.5 20 1000\n";
    let file = text(&format!("pos u rho\n{rows}")).unwrap();
    assert_eq!(attributes(&file), [("u", 1), ("rho", 1)]);
    let wide = table(3, |i| format!("{} {} 0.5", place(i), place(i + 1)));
    for names in ["# v x", "v x", "# velocity r"] {
        assert_eq!(refusal(&format!("{names}\n{wide}")).0, 1, "{names}");
    }
}

#[test]
fn names_that_begin_with_the_axis_are_a_position_if_there_is_no_other() {
    for [x, y, z] in [
        ["x-coordinate", "y-coordinate", "z-coordinate"],
        ["x coordinate", "y coordinate", "z coordinate"],
        ["X_coord", "Y_coord", "Z_coord"],
        ["xcoord", "ycoord", "zcoord"],
        ["x_pos", "y_pos", "z_pos"],
        ["xpos", "ypos", "zpos"],
        ["xp", "yp", "zp"],
        ["x_m", "y_m", "z_m"],
        ["xu", "yu", "zu"],
        ["x1", "x2", "x3"],
        ["coord0", "coord1", "coord2"],
    ] {
        let file = text(&format!("id,{z},{y},{x}\n7,3,2,1\n")).expect(x);
        assert_eq!((positions(&file), attributes(&file)), (vec![[1.0, 2.0, 3.0]], vec![("id", 1)]));
        let file = text(&format!("{x},{y},{z},x,y,z\n7,8,9,1,2,3\n")).expect(x);
        assert_eq!(positions(&file), [[1.0, 2.0, 3.0]], "{x}");
        assert_eq!(attributes(&file), [(x, 1), (y, 1), (z, 1)]);
        assert_eq!(refusal(&format!("id,{x},{y}\n7,1,2\n")).0, 1);
    }
    let corners = "x1,y1,z1,x2,y2,z2,x3,y3,z3";
    assert_eq!(refusal(&format!("{corners}\n1,2,3,4,5,6,7,8,9\n")).0, 1);
}

#[test]
fn velocities_of_fluent_star_ccm_and_cfx_are_vectors() {
    for (names, velocity) in [
        ("x-velocity,y-velocity,z-velocity", "velocity"),
        ("Velocity[i] (m/s),Velocity[j] (m/s),Velocity[k] (m/s)", "Velocity"),
        ("Velocity u [ m s^-1 ],Velocity v [ m s^-1 ],Velocity w [ m s^-1 ]", "Velocity"),
    ] {
        let file = text(&format!("{names},X (m),Y (m),Z (m)\n4,5,6,1,2,3\n")).expect(names);
        assert_eq!(positions(&file), [[1.0, 2.0, 3.0]], "{names}");
        assert_eq!(attributes(&file), [(velocity, 3)], "{names}");
        assert_eq!(attribute(&file, velocity), [4.0, 5.0, 6.0], "{names}");
    }
    let file = text("x,y,z,u,v,w,A[i]\n1,2,3,4,5,6,7\n").unwrap();
    assert_eq!(attributes(&file), [("u", 1), ("v", 1), ("w", 1), ("A[i]", 1)]);
}

#[test]
fn a_line_of_names_that_does_not_fit_the_rows_is_refused() {
    let rows = table(3, |i| format!("{} {} 0.5 0.25", place(i), place(i + 1)));
    for (names, line) in [
        ("rho vel pos", 1),
        ("# rho vel pos", 1),
        ("% density, velocity, position", 1),
        ("density velocity(3) position(3)", 1),
        ("velocity position", 1),
        // The reader understands these seven names, so it refuses the first row, which has eight
        // columns.
        ("density[1] vx[2] vy[3] vz[4] x[5] y[6] z[7]", 2),
        ("# density[1] vx[2] vy[3] vz[4] x[6] y[7] z[8]", 1),
        ("; rho vel pos", 1),
        ("rho vel pos\n1920", 1),
        ("# rho vel pos\n1920\n# 0.5", 1),
        ("a title\nvelocity\nposition", 2),
        ("rho\nvx\nvy\nvz\nx\ny\nz\nm", 1),
        ("# rho\n# vx\n# vy\n# vz\n# x\n# y\n# z\n# m", 1),
    ] {
        let (at, what) = refusal(&format!("{names}\n{rows}"));
        assert_eq!(at, line, "{names}: {what}");
    }
}

#[test]
fn titles_with_a_few_names_of_columns_do_not_name_the_columns() {
    let rows = table(5, |i| format!("{} 0.5", place(i)));
    let expected = positions(&text(&rows).unwrap());
    for title in [
        "Material point positions",
        "SPH mass density output",
        "Material type: water",
        "units: m, m, m, kg",
        "velocities are in another file",
    ] {
        let file = text(&format!("# {title}\n{rows}")).expect(title);
        assert_eq!(positions(&file), expected, "{title}");
    }
    let rows = table(5, |i| format!("{} {} 0.5", place(i), place(i + 1)));
    let file = text(&format!("# x y z\n# vx vy vz rho\n{rows}")).unwrap();
    assert_eq!(positions(&file), expected);
}

#[test]
fn a_first_row_that_announces_the_number_of_rows_is_left_out() {
    let rows = table(20, place);
    for head in ["20 0.5 0.1", "20 3 1", "# N time dt\n20 0.5 0.1\n# x y z", "20, 0.5, 0.1"] {
        let rows = if head.contains(',') { rows.replace(' ', ", ") } else { rows.clone() };
        let file = text(&format!("{head}\n{rows}")).expect(head);
        assert_eq!(positions(&file), three_columns(&rows.replace(',', ""), 0), "{head}");
    }
    let wide = table(9, |i| format!("{} {}", place(i), place(i + 9)));
    let file = text(&format!("9 1 2 3 4 5\n{wide}")).unwrap();
    assert_eq!(positions(&file), three_columns(&wide, 0));
    let lattice = table(27, |i| format!("{} {} {}", i / 9, i / 3 % 3, i % 3));
    let file = text(&format!("27 3 3\n{lattice}")).unwrap();
    assert_eq!(positions(&file), three_columns(&lattice, 0));
}

#[test]
fn a_first_row_that_may_be_a_particle_is_kept() {
    for rows in [
        format!("19 0.5 0.1\n{}", table(20, place)),
        format!("20.0 0.5 0.1\n{}", table(20, place)),
        format!("7 0.5 0.1\n{}", table(7, place)),
        table(21, |i| format!("{} 0 {}", 20 - 2 * i as i64, i % 2)),
        table(300, |i| format!("{} 0 0", 299 - i)),
    ] {
        assert_eq!(positions(&text(&rows).expect(&rows)), three_columns(&rows, 0), "{rows}");
    }
    // The first column has row numbers.
    let rows = table(20, |i| format!("{} {}", 19 - i, place(i)));
    assert_eq!(positions(&text(&rows).unwrap()), three_columns(&rows, 1));
}

#[test]
fn rows_without_values_are_ignored_only_at_the_end() {
    let expected = [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]];
    for end in [";;", ";;\n;;\n", " ; ;\n# end\n\n;;;\n", "\"\";\"\";\"\""] {
        let file = text(&format!("x;y;z\n1;2;3\n4;5;6\n{end}")).expect(end);
        assert_eq!(positions(&file), expected, "{end}");
    }
    let count = |table: &str| positions(&text(table).unwrap()).len();
    assert_eq!(count("x,y,z\n1,2,3\n\n,,\n,,\n4,5,6\n"), 4);
    // The empty rows and the other rows are in different pieces of the text.
    let rows = "1,2,3\n".repeat(200_000);
    let empty = ",,\n".repeat(100_000);
    assert_eq!(count(&format!("{rows}{empty}{rows}")), 500_000);
    assert_eq!(count(&format!("{rows}{empty}")), 200_000);
    assert_eq!(count(&format!("{rows}{empty}{rows}{empty}")), 500_000);
}

#[test]
fn a_table_that_a_column_of_times_divides_into_frames_gives_a_warning() {
    let frames =
        |time: fn(usize) -> String| table(40, |i| format!("{} {}", time(i / 10), place(i)));
    let times = |column: &str, count, first: &str, last: &str| {
        let (column, first, last) = (column.to_owned(), first.to_owned(), last.to_owned());
        vec![UnreadPart::Times { column, count, first, last }]
    };
    let rows = frames(|frame| format!("{}", 0.25 * frame as f64));
    for name in ["time", "Frame", "timestep", "STEP", "t"] {
        let file = text(&format!("{name} x y z\n{rows}")).expect(name);
        assert_eq!(file.left_out, times(name, 4, "0", "0.75"), "{name}");
        assert_eq!(positions(&file).len(), 40);
    }
    let long = table(60_000, |i| format!("{} {}", i / 20_000, place(i)));
    let file = text(&format!("time x y z\n{long}")).unwrap();
    assert_eq!(file.left_out, times("time", 3, "0", "2"));
    for name in ["Time [s]", "TimeStamp", "time_s", "t[s]", "Snapshot", "frame_number"] {
        let rows = rows.replace(' ', ",");
        let file = text(&format!("{name},x,y,z\n{rows}")).expect(name);
        assert!(matches!(file.left_out[..], [UnreadPart::Times { count: 4, .. }]), "{name}");
    }
    for (name, rows) in [
        ("age", rows.clone()),
        ("T", rows.clone()),
        ("time", frames(|_| "1".to_owned())),
        ("t", table(40, |i| format!("{i} {}", place(i)))),
        ("time", table(40, |i| format!("{} {}", i / 3, place(i)))),
        ("time", table(40, |i| format!("{} {}", i.saturating_sub(20), place(i)))),
        ("t", table(70_000, |i| format!("{} {}", i as f64 / 7.0, place(i)))),
        ("t", table(40, |i| format!("{} {}", 300 + 50 * (i / 30), place(i)))),
        ("iter", table(40, |i| format!("{} {}", 3 + i / 30, place(i)))),
    ] {
        let file = text(&format!("{name} x y z\n{rows}")).expect(name);
        assert_eq!(file.left_out, [], "{name}\n{rows}");
    }
    let condition: [Where; 1] = ["time=0.25".parse().unwrap()];
    let wanted =
        WantedAttributes::Only { names: None, conditions: &condition, sizes: &SizeChoice::Ignored };
    let bytes = format!("time x y z\n{rows}").into_bytes().into();
    let hint = TextHint::Named(InputFormat::Csv);
    let read =
        text_format::read_particles(bytes, hint, (None, None), wanted, Unpacking::in_memory());
    assert_eq!(read.unwrap().left_out, []);
}

#[test]
fn frames_whose_rows_are_interleaved_or_unequal_give_a_warning() {
    let found = |names: &str, rows: &str| text(&format!("{names}\n{rows}")).unwrap().left_out;
    let times = |column: &str, count, last: &str| {
        let (column, first, last) = (column.to_owned(), "0".to_owned(), last.to_owned());
        vec![UnreadPart::Times { column, count, first, last }]
    };
    // The rows give the path of each particle: each particle has a row for each of the four times.
    let paths = table(40, |i| format!("{} {} {}", i / 4, 0.25 * (i % 4) as f64, place(i)));
    assert_eq!(found("id t x y z", &paths), times("t", 4, "0.75"));
    let long = table(60_000, |i| format!("{} {}", i % 3, place(i)));
    assert_eq!(found("Frame x y z", &long), times("Frame", 3, "2"));
    let descending = table(40, |i| format!("{} {}", 3 - i / 10, place(i)));
    assert_eq!(found("time x y z", &descending), times("time", 4, "3"));
    let growing = table(40, |i| format!("{} {}", i / 30, place(i)));
    assert_eq!(found("time x y z", &growing), times("time", 2, "1"));
    // Of the columns `step` and `time`, only `time` has several values.
    let constant = table(40, |i| format!("7 {} {}", i % 2, place(i)));
    assert_eq!(found("step time x y z", &constant), times("time", 2, "1"));
    // Spreadsheets write empty rows at the end.
    let sheet = table(40, |i| format!("{} {}", i % 2, place(i))).replace(' ', ",") + ",,,\n,,,\n";
    assert_eq!(found("time,x,y,z", &sheet), times("time", 2, "1"));
}

#[test]
fn opensph_names_with_blanks_and_axes_in_brackets_are_understood() {
    let head = "# Run: unnamed\n# SPH dump, time = 0.1\n";
    for [open, close] in [["[", "]"], ["(", ")"]] {
        let of = |name: &str| {
            ["x", "y", "z"].map(|axis| format!("{name} {open}{axis}{close}")).join("        ")
        };
        let names = format!("#         {}        {}", of("Velocity"), of("Position"));
        let file = text(&format!("{head}{names}\n{VELOCITY_FIRST}")).unwrap();
        assert_eq!(
            (positions(&file), attributes(&file)),
            (POSITIONS.to_vec(), vec![("Velocity", 3)])
        );

        let names = format!(
            "#       Particle index        {}        {}        Smoothing length    Density",
            of("Position"),
            of("Velocity")
        );
        let rows = "    0    1.5    2.5    3.5    0.5    0.25    -0.5    0.06    1000\n\
                        1    4.5    5.5    6.5    0.75    0.5    0.25    0.06    1000\n";
        let file = text(&format!("{head}{names}\n{rows}")).unwrap();
        assert_eq!(positions(&file), POSITIONS);
        let expected =
            [("Particle index", 1), ("Velocity", 3), ("Smoothing length", 1), ("Density", 1)];
        assert_eq!(attributes(&file), expected);
        assert_eq!(attribute(&file, "Velocity"), VELOCITIES);
    }
}

#[test]
fn a_comment_whose_names_do_not_fit_the_rows_is_refused() {
    for (names, line) in [
        ("# vx vy vz x y z rho", 1),
        ("# vx[m/s] vy[m/s] vz[m/s] x[m] y[m] z[m] rho[kg/m^3]", 1),
        ("# id x (m) y (m) z (m)\n# ------", 1),
        ("# [1] vx [2] vy [4] x [5] y [6] z", 1),
        ("# [3] x\n# [4] y\n# [5] z", 3),
        ("# [0] vx\n# [1] vy\n# [3] x\n# [4] y\n# [5] z", 5),
        ("# Particle index  Position [x]  Position [y]  Position [z]", 1),
        ("# velocity: vx vy vz, position: x y z", 1),
        ("# velocity (x, y, z), position (x, y, z)", 1),
        ("# velocities vx, vy, vz; positions x, y, z", 1),
        ("# vx in m/s, vy in m/s, vz in m/s, x in m, y in m, z in m", 1),
        ("# the velocity vx vy vz and the position x_m y_m z_m of it", 1),
        ("# z y x of all particles", 1),
        ("# x[m] y[m] z[m] x[m] y[m] z[m]", 1),
        ("# x (m) y (m) a (1) b (1) c (1) d (1)", 1),
        ("# velocity_x velocity_y velocity_z center_x center_y center_z", 1),
        ("# vx vy vz qx qy qz", 1),
        ("# vx/(m/s), vy/(m/s), vz/(m/s), qx/m, qy/m, qz/m", 1),
        ("# vx vy vz x0 y0 z0 x1 y1 z1", 1),
        ("# density pressure temperature cx cy cz", 1),
        ("# vel[0] vel[1] vel[2] a b c", 1),
        ("# id: 1:vx 2:vy 3:vz 4:qx 5:qy 6:qz", 1),
    ] {
        let (at, what) = refusal(&format!("{names}\n{VELOCITY_FIRST}"));
        assert_eq!(at, line, "{names}: {what}");
    }
    let (_, what) = refusal(&format!("# vx vy vz x y z rho\n{VELOCITY_FIRST}"));
    assert!(what.contains("6 columns") && what.contains("\"vx vy vz x y z rho\""), "{what}");
}

#[test]
fn sentences_and_numbers_in_comments_are_not_taken_for_names() {
    let numbered = table(3, |i| format!("{i} {} {}", place(i), place(i + 1)));
    let rows = table(3, |i| format!("{} {}", place(i), place(i + 1)));
    for comment in [
        "# written by foo x 3",
        "# t = 0.1",
        "# n = 5 x 5 x 5",
        "# 5 x 5 y 5 z",
        "# x: 0 1, y: 0 1, z: 0 2",
        "# x=0..1 y=0..1 z=0..2",
        "# gravity x 0 y 0 z -9.81",
        "# gravity (x y z): 0 0 -9.81",
        "# domain size (x, y, z) = (1, 2, 1)",
        "# domain x=[0,1] y=[0,1] z=[0,1]",
        "# x-axis right, y-axis up, z-axis out",
        "# x y z",
        "# x y z of all particles",
        "# x, y, z and the velocities",
        "# periodic in x, y, z",
        "# periodic in x y z",
        "# x is right, y is up and z points at the viewer",
        "# 1. x is to the right\n# 2. y is up\n# 3. z is depth",
        "# position (x, y, z), velocity",
        "# Lx Ly Lz",
        "# Lx Ly Lz nx ny nz",
        "# h Lx Ly Lz",
        "# m m m m/s m/s m/s",
        "# kg m s Pa K J",
        "# Generated by OVITO Pro 3.10.2",
        "# Created with NumPy 1.26 and Python 3.12",
        "# DualSPHysics v5.2 - Part 0020",
        "# SPHysics output file, version 2.2",
        "# LIGGGHTS dump of step 1000",
        "# 2024-03-05 12:30:59",
        "# 05/03/2024 12:30",
        "# Tue Mar  5 12:30:59 2024",
        "# host: node01, user: anna, 16 ranks",
        "# dt = 1e-4 s, h = 0.02 m",
        "# rho0 = 1000 kg/m^3, c0 = 20 m/s",
        "# viscosity: 1e-6 m^2/s",
        "# number of particles: 1920",
        "# units: m, m/s",
        "# velocity field of the fluid phase",
        "# density field of run no. 7",
        "# mass density output of SPH code",
        "# pressure in Pa",
        "# v and x of run 7",
        "# dam break test case 2",
        "# -*- coding: utf-8 -*-",
        "% Data exported from COMSOL 6.1",
        "! Fortran output unit 20",
        "// time step 12",
        "# 1 2 3 4 5 6",
        "# [m] [m] [m]",
        "# created by x at 12:30",
        "# 1920 particles",
        "# time = 0.5, step 3",
        "# initial positions and velocities",
        "# position, velocity, density and more",
        "# density 1000, viscosity 0.01, gravity 9.81",
        "# pressure at time 0.5",
        "# SPH solver, velocity limited to 3, position unlimited",
        "Particle positions",
        "x y plane",
        "density of the fluid",
        "a title\nby x\nfinal",
    ] {
        for (rows, first) in [(&rows, 0), (&numbered, 1)] {
            let file = text(&format!("{comment}\n{rows}")).expect(comment);
            assert_eq!(positions(&file), three_columns(rows, first), "{comment}");
        }
    }
    // Rows of three numbers can only be positions.
    let rows = table(3, place);
    for comment in [
        "# x y z of all particles",
        "# positions x y z of the particles in metres",
        "# x in m, y in m, z in m",
        "# x y z (m)",
        "# [0] x\n# [1] y\n# [2] z",
    ] {
        let file = text(&format!("{comment}\n{rows}")).expect(comment);
        assert_eq!(positions(&file), three_columns(&rows, 0), "{comment}");
    }
}

#[test]
fn decimal_commas_between_separating_commas_are_refused() {
    let decimals = |i: usize| [0.517342, 0.023111, 1.5].map(|x| format!("{:.6}", x + i as f64));
    for separator in [", ", ","] {
        let row = |i| decimals(i).map(|number| number.replace('.', ",")).join(separator);
        assert_eq!(refusal(&table(9, row)).0, 1, "{separator:?}");
        let row = |i| decimals(i).join(separator);
        assert_eq!(positions(&text(&table(9, row)).unwrap()).len(), 9);
    }
    for integers in ["1,20,3,40,5,60\n2,20,3,41,5,60\n", "1, 2, 3, 4, 5, 6\n7, 8, 9, 1, 2, 3\n"] {
        let refused = text(integers).err().map(|fault| fault.to_string()).unwrap_or_default();
        assert!(!refused.contains("decimal"), "{refused}");
    }
}

#[test]
fn names_above_a_title_do_not_concern_the_rows() {
    let rows = table(3, |i| format!("{} {}", place(i), place(i + 1)));
    let file = text(&format!("# vx vy vz x y z rho\nwater\n{rows}")).unwrap();
    assert_eq!(positions(&file), three_columns(&rows, 0));
}

#[test]
fn names_without_the_row_number_are_accepted_only_if_x_is_first() {
    let rows = table(3, |i| format!("{i} {} {}", place(i), place(i + 1)));
    let file = text(&format!("# x y z vx vy vz\n{rows}")).unwrap();
    assert_eq!(positions(&file), three_columns(&rows, 1));
    assert_eq!(refusal(&format!("# vx vy vz x y z\n{rows}")).0, 1);
    let file = text(&format!("# id and position, velocity\n{rows}")).unwrap();
    assert_eq!(positions(&file), three_columns(&rows, 1));
    assert_eq!(refusal(&format!("# mass, id and position, velocity\n{rows}")).0, 1);
}

#[test]
fn units_without_a_blank_are_removed_only_if_the_position_has_one() {
    let file = text("x[m],y[m],z[m],vel[0],vel[1],vel[2],rho[kg/m^3]\n1,2,3,4,5,6,7\n").unwrap();
    assert_eq!(attributes(&file), [("vel", 3), ("rho", 1)]);
    let file = text("x,y,z,log(rho),a[1]\n1,2,3,4,5\n").unwrap();
    assert_eq!(attributes(&file), [("log(rho)", 1), ("a[1]", 1)]);
    let file = text("x(m),y(m),z(m),phi(air),phi(water)\n1,2,3,4,5\n").unwrap();
    assert_eq!(attributes(&file), [("phi(air)", 1), ("phi(water)", 1)]);
}

#[test]
fn decorated_names_in_the_comment_of_an_xyz_frame_are_understood() {
    for names in ["# vx[m/s] vy[m/s] vz[m/s] x[m] y[m] z[m]", "1:vx 2:vy 3:vz 4:x 5:y 6:z"] {
        let frame = format!("2\n{names}\n{VELOCITY_FIRST}");
        let file = read_as(InputFormat::Xyz, &frame).expect(names);
        assert_eq!((file.format, positions(&file)), ("XYZ", POSITIONS.to_vec()), "{names}");
        assert_eq!(attributes(&file), [("v", 3)], "{names}");
    }
}

#[test]
fn the_points_of_paraview_are_preferred_to_columns_x_y_and_z() {
    let file = text("x,y,z,Points:0,Points:1,Points:2\n1,2,3,1.5,2.5,3.5\n4,5,6,4.5,5.5,6.5\n");
    let file = file.unwrap();
    assert_eq!((positions(&file), attributes(&file)), (POSITIONS.to_vec(), vec![("xyz", 3)]));
    assert_eq!(attribute(&file, "xyz"), [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
    // Columns with a common stem that may mean a pressure are not preferred to columns x, y and z.
    let file = text("p_xx,p_xy,p_xz,x,y,z\n1,2,3,1.5,2.5,3.5\n4,5,6,4.5,5.5,6.5\n").unwrap();
    assert_eq!((positions(&file), attributes(&file)), (POSITIONS.to_vec(), vec![("p_x", 3)]));
}

#[test]
fn tables_with_two_coordinates_lead_to_advice_to_add_a_third() {
    for table in ["x,y\n1,2\n", "id,x,y\n1,2,3\n", "x [m];y [m];m\n1;2;3\n", "1 2\n3 4\n"] {
        let (_, what) = refusal(table);
        assert!(what.contains("z that is 0"), "{what}");
    }
    for table in ["a,b\n1,2\n", "1\n2\n", "r,z,m\n1,2,3\n"] {
        let (_, what) = refusal(table);
        assert!(!what.contains("z that is 0"), "{what}");
    }
}
