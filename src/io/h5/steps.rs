//! Reads particles in groups of any name, in one or more frames. Frames are numbered groups, such
//! as `Step#12` of H5Part, or the first axis of arrays.

use hdf5_reader::group::Group;

use crate::io::error::{no_step, several_steps};
use crate::io::wanted::WantedParticles;
use crate::io::{ParticleFile, ReadFault};

use super::file::{H5File, convert_error, time_of, times_in};
use super::groups::GroupSearch;

/// Prefix of the names of H5Part's groups.
const STEP: &str = "step#";
/// Words, in lower case, that precede the number in the name of a frame's group.
const WORDS: [&str; 14] = [
    "step",
    "timestep",
    "time_step",
    "frame",
    "iteration",
    "iter",
    "cycle",
    "snapshot",
    "snap",
    "time",
    "t",
    "output",
    "state",
    "dump",
];
/// Names, in lower case, of groups that may contain frames whose names are bare numbers.
const PARENTS: [&str; 12] = [
    "timestepdata",
    "timesteps",
    "steps",
    "frames",
    "data",
    "iterations",
    "snapshots",
    "snaps",
    "results",
    "times",
    "timeseries",
    "trajectory",
];

/// Reads a frame.
///
/// The frame is stored in a numbered group or in arrays whose first axis counts frames, or it is
/// the whole file. If there are several groups of particles, [`GroupSearch::chosen`] selects one.
pub fn read_particles(
    file: H5File,
    step: Option<u64>,
    wanted: WantedParticles,
) -> Result<ParticleFile, ReadFault> {
    let root = file.root()?;
    let numbered = numbered(&root, &file)?;
    let (group, frame) = match (step, &*numbered) {
        (frame, []) => (root.clone(), frame),
        (Some(step), known) => {
            let found = known.iter().find(|(number, _)| *number == step);
            (found.ok_or_else(|| no_step(step))?.1.clone(), None)
        }
        (None, [(_, only)]) => (only.clone(), None),
        (None, [(first, _), .., (last, _)]) => return Err(several_steps(*first, *last)),
    };
    let (candidate, particle_types) =
        GroupSearch::of(&group, &file)?.chosen(&group, wanted.conditions)?;
    candidate.check_frames(&file)?;
    let frame = candidate.arrangement.frame(frame)?;
    let time = candidate.time(frame).or_else(|| match candidate.frames() {
        Some(_) => None,
        None => [&group, &root]
            .into_iter()
            .find_map(|group| time_of(group).or_else(|| times_in(group, None))),
    });
    let box_size = candidate.box_size(frame);
    let table = candidate.table(frame)?;
    drop((candidate, numbered, group, root));
    Ok(ParticleFile {
        time,
        box_size,
        particle_types,
        ..table.read(file, "HDF5", wanted.attributes)?
    })
}

/// The numbers of the frames, in order. Empty for a file with a single frame.
pub fn steps(file: &H5File) -> Result<Vec<u64>, ReadFault> {
    let root = file.root()?;
    let numbered = numbered(&root, file)?;
    if !numbered.is_empty() {
        return Ok(numbered.into_iter().map(|(number, _)| number).collect());
    }
    let search = GroupSearch::of(&root, file)?;
    let several = search.candidates.iter().filter(|c| c.frames().is_some_and(|frames| frames > 1));
    // This function only counts frames, so several groups of particles are not an error here.
    // Reading a frame fails if it is unclear which group to read.
    let Some(longest) = several.max_by_key(|candidate| candidate.frames()) else {
        return Ok(Vec::new());
    };
    longest.check_frames(file)?;
    Ok(longest.arrangement.steps())
}

/// The groups that contain one frame each, sorted by number.
///
/// If there are groups of H5Part, this function returns them. Otherwise, it returns numbered groups
/// with the same parent if the first of these groups contains positions. If there are no such
/// groups either, it returns the result of [`bare_numbers`].
fn numbered(root: &Group, file: &H5File) -> Result<Vec<(u64, Group)>, ReadFault> {
    let groups = convert_error(root.groups())?;
    let h5part = in_group(&groups, |name| name.strip_prefix(STEP)?.parse().ok());
    if !h5part.is_empty() {
        return Ok(h5part);
    }
    let mut found = vec![in_group(&groups, |name| step_number(name, ""))];
    for group in &groups {
        let parent = group.name().to_ascii_lowercase();
        let parent = super::groups::last_name(&parent);
        let is_frame_name =
            |name: &String| step_number(&name.to_ascii_lowercase(), parent).is_some();
        if convert_error(group.member_names())?.0.iter().any(is_frame_name) {
            found.push(in_group(&convert_error(group.groups())?, |name| step_number(name, parent)));
        }
    }
    for frames in found {
        let Some((_, first)) = frames.first() else { continue };
        if !GroupSearch::of(first, file)?.candidates.is_empty() {
            return Ok(frames);
        }
    }
    bare_numbers(&groups, file)
}

/// The groups of the root that contain one frame each, if their names are bare numbers, such as
/// `000120`. There must be at least two of these groups. They must have different numbers and the
/// same members, at least one name must have two or more digits, and the first group must contain
/// positions.
///
/// A bare number may also be the name of a particle type. Names of particle types usually have a
/// single digit. This function returns no groups if the members differ, or if a group with another
/// name contains positions.
fn bare_numbers(groups: &[Group], file: &H5File) -> Result<Vec<(u64, Group)>, ReadFault> {
    let number = |name: &str| {
        let is_bare = name.bytes().all(|letter| letter.is_ascii_digit());
        name.parse::<u64>().ok().filter(|_| is_bare)
    };
    let is_bare = |group: &&Group| number(super::groups::last_name(group.name())).is_some();
    let (bare, others): (Vec<_>, Vec<_>) = groups.iter().partition(is_bare);
    let frames = in_group(groups, number);
    let digits = |group: &Group| super::groups::last_name(group.name()).len();
    let may_be_types = bare.iter().all(|group| digits(group) == 1);
    if frames.len() < 2 || frames.len() < bare.len() || may_be_types {
        return Ok(Vec::new());
    }
    let members = |group: &Group| {
        let (mut groups, mut sets) = convert_error(group.member_names())?;
        groups.sort_unstable();
        sets.sort_unstable();
        Ok::<_, ReadFault>((groups, sets))
    };
    let has_positions =
        |group: &Group| Ok::<_, ReadFault>(!GroupSearch::of(group, file)?.candidates.is_empty());
    let first = &frames[0].1;
    if !has_positions(first)? {
        return Ok(Vec::new());
    }
    let known = members(first)?;
    for (_, frame) in &frames[1..] {
        if members(frame)? != known {
            return Ok(Vec::new());
        }
    }
    for other in others {
        if has_positions(other)? {
            return Ok(Vec::new());
        }
    }
    Ok(frames)
}

/// The groups whose names contain a number, each with its number, sorted by number. `number` finds
/// the number in a name in lower case.
fn in_group(groups: &[Group], number: impl Fn(&str) -> Option<u64>) -> Vec<(u64, Group)> {
    let number = |group: &Group| {
        let name = group.name().to_ascii_lowercase();
        Some((number(super::groups::last_name(&name))?, group.clone()))
    };
    let mut found: Vec<_> = groups.iter().filter_map(number).collect();
    found.sort_by(|(a, one), (b, other)| (a, one.name()).cmp(&(b, other.name())));
    found.dedup_by_key(|(number, _)| *number);
    found
}

/// The frame number that a group's name contains. `name` and the parent group's name `parent` must
/// be in lower case.
fn step_number(name: &str, parent: &str) -> Option<u64> {
    let digits = name.trim_start_matches(|letter: char| !letter.is_ascii_digit());
    let word = name[..name.len() - digits.len()].trim_end_matches(['#', '_', '-', ' ', ':', '=']);
    let is_frame = WORDS.contains(&word) || word.is_empty() && PARENTS.contains(&parent);
    digits.parse().ok().filter(|_| is_frame)
}

#[cfg(test)]
mod tests {
    use super::step_number;

    #[test]
    fn a_number_is_a_frame_number_only_after_a_word_that_means_frame() {
        for (name, parent, number) in [
            ("step_0010", "", Some(10)),
            ("frame7", "", Some(7)),
            ("1", "timestepdata", Some(1)),
            ("1", "particletypes", None),
            ("parttype0", "", None),
            ("time_0.5", "", None),
            ("step", "", None),
        ] {
            assert_eq!(step_number(name, parent), number, "{name} in {parent}");
        }
    }
}
