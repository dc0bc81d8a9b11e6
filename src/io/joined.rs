//! Checks files that are joined: no file occurs twice, and a colour has compatible scales in all
//! files.

use std::collections::HashMap;
use std::path::Path;

use crate::particles::kind::evident_scale;
use crate::particles::{AttributeInfo, AttributeKind, Particles, attribute_called};

use super::collection::is_list;
use super::error::ColourScale;
use super::frame_files::files_of;
use super::input::file_and_step;
use super::stamp::Identity;
use super::wanted::WantedAttributes;
use super::{ParticleFile, Pieces, ReadError, ReadFault};

/// Returns an error if two paths, with the same or different names, refer to the same file and
/// frame.
///
/// # Errors
/// [`ReadFault::Twice`] with the first repeated path.
pub fn check_distinct_files<'a>(
    paths: impl IntoIterator<Item = &'a Path>,
) -> Result<(), ReadError> {
    let mut known: HashMap<(Identity, Option<u64>), &Path> = HashMap::new();
    for path in paths {
        let (file, step) = file_and_step(path);
        let step = step.filter(|_| !is_list(file));
        for file in files_of(path) {
            if let Some(other) = known.insert((Identity::of(&file), step), path) {
                let fault = ReadFault::Twice { other: other.to_owned() };
                return Err(ReadError::new(path, fault));
            }
        }
    }
    Ok(())
}

/// Returns an error if a requested colour has different scales in different files. `files` has
/// `None` for files that were not opened.
///
/// Bytes and fractions from 0 to 1 can be joined. Floating-point numbers from 0 to 255 can be
/// joined neither with bytes nor with fractions, and colours cannot be joined with plain numbers.
/// Wider integers from 0 to 255 count as bytes.
///
/// # Errors
/// [`ReadFault::ColourScale`] with the first file whose scale differs.
pub(super) fn check_colour_scales(
    paths: &[&Path],
    files: &[Option<ParticleFile>],
    wanted: WantedAttributes,
) -> Result<(), ReadError> {
    let WantedAttributes::Only { names: Some(names), .. } = wanted else { return Ok(()) };
    let opened =
        || paths.iter().zip(files).filter_map(|(path, file)| Some((*path, file.as_ref()?)));
    let filled = || opened().filter(|(_, file)| !file.particles.is_empty());
    let Some((_, first)) = filled().next() else { return Ok(()) };
    for name in names {
        let infos = first.particles.attributes();
        let Some(wanted) = attribute_called(name, infos).map(|index| &infos[index]) else {
            continue;
        };
        let is_it = |info: &AttributeInfo| {
            (&info.name, info.components) == (&wanted.name, wanted.components)
        };
        let mut of_files = Vec::new();
        for (path, file) in filled() {
            let particles = &file.particles;
            let index = particles.attributes().iter().position(is_it);
            of_files.extend(index.map(|index| (path, particles, index)));
        }
        let is_colour = |&(_, particles, index): &(_, &Pieces, usize)| {
            particles.attributes()[index].kind.is_colour()
        };
        if !of_files.iter().any(is_colour) || all_same_integer_type(&of_files) {
            continue;
        }
        let mut known: Option<(&Path, ColourScale)> = None;
        for (path, particles, index) in of_files {
            let Some(scale) = scale_of(particles, index) else { continue };
            let (other, of_other) = *known.get_or_insert((path, scale));
            if !is_joinable(scale, of_other) {
                let (attribute, other) = (wanted.name.clone(), other.to_owned());
                let fault = ReadFault::ColourScale { attribute, scale, other, of_other };
                return Err(ReadError::new(path, fault));
            }
        }
    }
    Ok(())
}

/// Whether all files store a colour as integers of one type. Such a colour gets the scale that fits
/// the values of all files.
fn all_same_integer_type(of_files: &[(&Path, &Pieces, usize)]) -> bool {
    let mut kinds =
        of_files.iter().map(|&(_, particles, index)| particles.attributes()[index].kind);
    let first = kinds.next();
    first.is_some_and(AttributeKind::is_whole_colour) && kinds.all(|kind| Some(kind) == first)
}

/// The scale of a colour. `None` if its values fit several scales, for example if all are 0.
fn scale_of(particles: &Pieces, index: usize) -> Option<ColourScale> {
    let kind = particles.attributes()[index].kind;
    if kind.is_whole_colour() {
        let is_bytes = evident_scale(particles, index)? == AttributeKind::ByteColour;
        return Some(if is_bytes { ColourScale::Bytes } else { ColourScale::Whole });
    }
    Some(match kind {
        AttributeKind::ByteColour => ColourScale::Bytes,
        AttributeKind::Colour => match evident_scale(particles, index)? {
            AttributeKind::ByteColour => ColourScale::LargeShares,
            _ => ColourScale::Shares,
        },
        _ => ColourScale::Whole,
    })
}

/// Whether colours of two scales can be joined. Bytes can be joined with fractions, because a byte
/// becomes a fraction when it is divided by 255.
fn is_joinable(one: ColourScale, other: ColourScale) -> bool {
    use ColourScale::{Bytes, Shares};
    one == other || matches!((one, other), (Bytes, Shares) | (Shares, Bytes))
}
