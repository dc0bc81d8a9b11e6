//! Tests of joined files: the colours of all files get the same scale, and no colour is scaled
//! twice.

use std::fs;
use std::path::Path;

use meniscus::internals::io::bytes::Unpacking;
use meniscus::internals::io::input::open_joined;
use meniscus::internals::io::wanted::{WantedAttributes, WantedParticles, WantedPieces};
use meniscus::internals::io::{ColourScale, ParticleFile, ReadError, ReadFault};
use meniscus::internals::particles::sizes::SizeChoice;
use meniscus::internals::particles::{AttributeKind, Particles};
use tempfile::TempDir;

use crate::build::Bi4;
use crate::common::particle_files::attribute;

/// The properties of a colour that is called `Cd`, in any number type.
const CD: [&str; 3] = ["Cd_0", "Cd_1", "Cd_2"];

/// Writes two particles, each with a colour of the number type `scalar`.
fn coloured(path: &Path, scalar: &str, colours: [&str; 2]) {
    coloured_in(path, ["red", "green", "blue"], scalar, colours);
}

/// Like [`coloured`], with the colour in the properties `names`.
fn coloured_in(path: &Path, names: [&str; 3], scalar: &str, colours: [&str; 2]) {
    let properties: String = names.map(|name| format!("property {scalar} {name}\n")).concat();
    let [one, other] = colours;
    let text = format!(
        "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\n\
         property float z\n{properties}end_header\n0 0 0 {one}\n1 0 0 {other}\n"
    );
    fs::write(path, text).unwrap();
}

fn join(paths: &[&Path]) -> Result<ParticleFile, ReadError> {
    let names = ["rgb".to_owned()];
    let attributes = WantedAttributes::Only {
        names: Some(&names),
        conditions: &[],
        sizes: &SizeChoice::Ignored,
    };
    open_joined(
        paths,
        WantedParticles { attributes, ..WantedParticles::default() },
        Unpacking::in_memory(),
    )
}

#[test]
fn joined_byte_colours_become_fractions_and_other_scale_mixes_are_refused() {
    let folder = TempDir::new().unwrap();
    let [bytes, shares, large, dark] =
        ["bytes", "shares", "large", "dark"].map(|name| folder.path().join(name));
    let [bytes, shares, large, dark] =
        [bytes, shares, large, dark].map(|path| path.with_extension("ply"));
    coloured(&bytes, "uchar", ["255 51 0", "0 0 0"]);
    coloured(&shares, "float", ["1 0.5 0", "0 0 0"]);
    coloured(&large, "float", ["255 51 0", "0 0 0"]);
    coloured(&dark, "float", ["0 0 0", "0 0 0"]);

    for paths in [[&*bytes, &*shares], [&*shares, &*bytes]] {
        let file = join(&paths).unwrap();
        let infos = Particles::attributes(&file.particles);
        assert_eq!(infos[0].kind, AttributeKind::Colour);
        let mut values = attribute(&file, &infos[0].name);
        values.sort_by(f32::total_cmp);
        assert_eq!(values[8..], [0.2, 0.5, 1.0, 1.0]);
    }
    use ColourScale::{Bytes, LargeShares, Shares};
    for (paths, scales) in
        [([&*shares, &*large], [LargeShares, Shares]), ([&*large, &*bytes], [Bytes, LargeShares])]
    {
        let refused = join(&paths).unwrap_err();
        let ReadFault::ColourScale { scale, other, of_other, .. } = &refused.fault else {
            panic!("{refused}")
        };
        assert_eq!((&*refused.path, &**other), (paths[1], paths[0]));
        assert_eq!([*scale, *of_other], scales);
    }
    // A black colour is 0 in every scale.
    for other in [&*shares, &*large, &*bytes] {
        join(&[&dark, other]).unwrap();
    }
}

#[test]
fn integer_colours_up_to_255_are_joined_like_bytes_and_others_refused() {
    use ColourScale::{Bytes, Shares, Whole};
    let folder = TempDir::new().unwrap();
    let written = |name: &str, scalar: &str, colours: [&str; 2]| {
        let path = folder.path().join(name);
        coloured_in(&path, CD, scalar, colours);
        path
    };
    let bytes = written("bytes.ply", "uchar", ["255 51 0", "0 0 0"]);
    let whole = written("whole.ply", "int", ["255 51 0", "0 0 0"]);
    let shares = written("shares.ply", "float", ["1 0.5 0", "0 0 0"]);
    let short = written("short.ply", "ushort", ["65535 0 0", "0 0 0"]);
    let dim = written("dim.ply", "ushort", ["200 0 0", "0 0 0"]);
    let kind = |paths: &[&Path]| Particles::attributes(&join(paths).unwrap().particles)[0].kind;
    assert_eq!(kind(&[&whole, &bytes]), AttributeKind::WholeColour);
    // Integers of one type get their scale from the values of all files.
    assert_eq!(kind(&[&short, &dim]), AttributeKind::ShortColour);
    let file = join(&[&whole, &shares]).unwrap();
    let mut values = attribute(&file, "Cd");
    values.sort_by(f32::total_cmp);
    assert_eq!(values[8..], [0.2, 0.5, 1.0, 1.0]);
    for (other, expected) in [(&whole, Bytes), (&bytes, Bytes), (&shares, Shares)] {
        let refused = join(&[&short, other]).unwrap_err();
        let ReadFault::ColourScale { scale, of_other, .. } = refused.fault else {
            panic!("{refused}")
        };
        assert_eq!([scale, of_other], [expected, Whole]);
    }
}

#[test]
fn velocities_with_different_usual_names_become_one_velocity() {
    let folder = TempDir::new().unwrap();
    let paths = ["a.csv", "b.csv", "c.csv"].map(|name| folder.path().join(name));
    fs::write(&paths[0], "x,y,z,rho\n").unwrap();
    fs::write(&paths[1], "x,y,z,vel_x,vel_y,vel_z\n1,2,3,4,5,6\n").unwrap();
    fs::write(&paths[2], "x,y,z,velocity_x,velocity_y,velocity_z\n1,2,3,7,8,9\n").unwrap();
    let paths: [&Path; 3] = [&paths[0], &paths[1], &paths[2]];
    let file = open_joined(&paths, WantedParticles::default(), Unpacking::in_memory()).unwrap();
    assert_eq!(attribute(&file, "vel"), [4.0, 5.0, 6.0, 7.0, 8.0, 9.0]);
    assert_eq!((file.particles.attributes().len(), file.left_out), (1, vec![]));
}

#[test]
fn a_file_cannot_be_joined_with_itself_under_any_path() {
    let folder = TempDir::new().unwrap();
    let [one, other] = ["a.ply", "b.ply"].map(|name| folder.path().join(name));
    coloured(&one, "uchar", ["1 2 3", "4 5 6"]);
    coloured(&other, "uchar", ["1 2 3", "4 5 6"]);
    join(&[&one, &other]).unwrap();
    let list = folder.path().join("list.pvd");
    let text = "<VTKFile><Collection><DataSet file=\"a.ply\"/></Collection></VTKFile>";
    fs::write(&list, text).unwrap();
    for again in [one.clone(), folder.path().join("./a.ply"), list] {
        let refused = join(&[&one, &other, &again]).unwrap_err();
        assert!(matches!(&refused.fault, ReadFault::Twice { other } if *other == one), "{refused}");
        assert_eq!(refused.path, again);
    }
}

#[test]
fn joined_files_with_different_spacings_give_each_particle_its_spacing() {
    let folder = TempDir::new().unwrap();
    let layout = Bi4 { big: false, wide: false, double: false, mixed: false, pieces: 1, piece: 0 };
    let points: Vec<[f64; 3]> = (0..7).map(|i| [f64::from(i), 0.0, 1.0]).collect();
    let paths = ["a.bi4", "b.bi4", "c.bi4"].map(|name| folder.path().join(name));
    for (path, spacing) in paths.iter().zip([0.25, 0.25, 0.5]) {
        fs::write(path, layout.build_spaced(&points, spacing)).unwrap();
    }
    let joined = |files: &[&Path], pieces: WantedPieces<'_>| {
        let wanted = WantedParticles { pieces, ..WantedParticles::default() };
        let file = open_joined(files, wanted, Unpacking::in_memory()).unwrap();
        let infos = file.particles.attributes();
        let number = infos.iter().position(|info| info.name == "spacing");
        let values = number.map(|number| {
            let mut values = vec![0.0; file.particles.len()];
            file.particles.attribute(number, 0, &mut values);
            values
        });
        (file.spacing, values)
    };
    let [a, b, c] = &paths;
    assert_eq!(joined(&[a, b], WantedPieces::All), (Some(0.25), None));
    let both = [[0.25; 7], [0.5; 7]].concat();
    assert_eq!(joined(&[a, c], WantedPieces::All), (None, Some(both)));
    // If only some of a frame's files are opened, as for a part, the attribute of the whole frame
    // must still be found.
    let (_, values) = joined(&[a, c], WantedPieces::Numbered(&[1]));
    assert_eq!(values, Some(vec![0.5; 7]));
}
