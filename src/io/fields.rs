//! Interprets named arrays of numbers. Finds the position, the attributes, and the axis along
//! which each array has one entry per particle.

use super::error::{no_step, several_steps};
use super::names::{
    Quantity, is_preferred_position, position_axis, quantities, time_arrays, without_unit,
};
use super::{ReadFault, UnreadPart, malformed};
use crate::particles::velocity::velocity_rank;

/// Characters around a unit in a name.
const BRACKETS: [char; 4] = ['(', ')', '[', ']'];
/// Maximum number of components of an attribute. An array with more components is a matrix or a
/// spectrum.
pub const MOST_COMPONENTS: u64 = 64;

/// Prefixes, in lower case, of the names of vectors that are not positions.
const NON_POSITION_PREFIXES: [&str; 14] = [
    "acc", "color", "colour", "disp", "force", "mom", "norm", "omega", "stress", "vel", "vort",
    "grad", "spin", "torque",
];

/// A named array of numbers.
#[derive(Debug, Clone)]
pub struct NamedArray {
    /// Name of the array.
    pub name: String,
    /// Sizes of its axes.
    pub shape: Vec<u64>,
}

/// Meaning of an array's axes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Axes {
    /// Particles and components: (N,), (N, 3) or (N, 3, 3).
    Particles,
    /// Components and particles: (3, N).
    Components,
    /// Frames, particles and components: (T, N) or (T, N, 3).
    Frames,
}

/// The numbers of frames, particles and components that an array's shape implies.
struct ArrayExtent {
    frames: Option<u64>,
    rows: u64,
    components: u64,
}

/// The place of a column: an array, and a component of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ColumnIndex {
    /// The index of the array.
    pub field: usize,
    /// The index of the component among the components of a particle, in row-major order.
    pub component: usize,
}

/// A quantity, with the places of its components.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LocatedQuantity {
    /// The name without unit and component.
    pub name: String,
    /// The place of each component.
    pub places: Vec<ColumnIndex>,
}

/// An interpretation of arrays with the same number of particles.
#[derive(Debug)]
pub struct Arrangement {
    /// Number of particles in each frame.
    pub rows: u64,
    /// Number of frames, if the position has an axis for frames.
    pub frames: Option<u64>,
    /// The axes of every array. Arbitrary for arrays that are not used.
    pub axes: Vec<Axes>,
    /// The position, which has three components.
    pub position: LocatedQuantity,
    /// The other quantities with the same number of particles.
    pub attributes: Vec<LocatedQuantity>,
    /// Arrays with too many numbers per particle, and arrays whose shape does not match the number
    /// of particles.
    pub left_out: Vec<UnreadPart>,
}

impl Arrangement {
    /// The step numbers of the frames. Empty if there is a single frame, or if there are no
    /// particles.
    pub fn steps(&self) -> Vec<u64> {
        // Return no steps if the frames have no particles. Such frames take no bytes, so even a
        // small file can declare any number of them.
        let frames = self.frames.filter(|frames| *frames > 1 && self.rows > 0);
        (0..frames.unwrap_or(0)).collect()
    }

    /// The frame with number `step`. If `step` is `None`, there must be a single frame.
    ///
    /// # Errors
    /// [`ReadFault::Unsupported`] for a step that does not exist, or for several frames without a
    /// `step`.
    pub fn frame(&self, step: Option<u64>) -> Result<u64, ReadFault> {
        match (step, self.frames) {
            (None, None | Some(1)) => Ok(0),
            (None, Some(0)) => {
                Err(ReadFault::Unsupported("the arrays contain no frames".to_owned()))
            }
            (None, Some(frames)) => Err(several_steps(0, frames - 1)),
            (Some(step), Some(frames)) if step < frames => Ok(step),
            (Some(step), _) => Err(no_step(step)),
        }
    }
}

impl Axes {
    /// The array's extent, or `None` if an array with these axes cannot have this shape.
    fn extent(self, shape: &[u64]) -> Option<ArrayExtent> {
        let components = |axes: &[u64]| {
            let product = axes.iter().try_fold(1u64, |product, &size| product.checked_mul(size))?;
            (1..=MOST_COMPONENTS).contains(&product).then_some(product)
        };
        Some(match (self, shape) {
            (Self::Particles, &[rows, ref axes @ ..]) => {
                ArrayExtent { frames: None, rows, components: components(axes)? }
            }
            (Self::Components, &[first, rows]) => {
                ArrayExtent { frames: None, rows, components: components(&[first])? }
            }
            (Self::Frames, &[frames, rows, ref axes @ ..]) => {
                ArrayExtent { frames: Some(frames), rows, components: components(axes)? }
            }
            _ => return None,
        })
    }

    /// The number of components of an array with these axes and this shape.
    pub fn components(self, shape: &[u64]) -> usize {
        self.extent(shape).map_or(0, |extent| extent.components as usize)
    }
}

/// Names and places of the columns of arrays. A vector has three columns, with the names `name.x`,
/// `name.y` and `name.z`.
struct NamedColumns<'a> {
    fields: &'a [NamedArray],
    names: Vec<String>,
    places: Vec<ColumnIndex>,
    others: Vec<LocatedQuantity>,
}

impl<'a> NamedColumns<'a> {
    fn of(fields: &'a [NamedArray]) -> Self {
        Self { fields, names: Vec::new(), places: Vec::new(), others: Vec::new() }
    }

    fn push(&mut self, field: usize, components: u64) {
        let name = &self.fields[field].name;
        let places = (0..components as usize).map(|component| ColumnIndex { field, component });
        match components {
            1 => self.names.push(name.clone()),
            3 if !is_one_axis(self.fields, field) => {
                let bare = without_unit(name);
                let namesakes = self.fields.iter().filter(|f| without_unit(&f.name) == bare);
                let is_unit = namesakes.count() == 1;
                let name = if is_unit { bare.to_owned() } else { name.replace(BRACKETS, "") };
                self.names.extend(["x", "y", "z"].map(|axis| format!("{name}.{axis}")))
            }
            _ => {
                let (name, places) = (name.clone(), places.collect());
                self.others.push(LocatedQuantity { name, places });
                return;
            }
        }
        self.places.extend(places);
    }

    /// Returns the position and the other quantities. `None` if there is no position.
    fn position(self) -> Option<(LocatedQuantity, Vec<LocatedQuantity>)> {
        let Self { names, places, others, .. } = self;
        let found = |q: Quantity| LocatedQuantity {
            name: q.name,
            places: q.columns.iter().map(|&column| places[column]).collect(),
        };
        let (position, rest) = quantities(&names)?;
        Some((found(position), rest.into_iter().map(found).chain(others).collect()))
    }
}

/// Finds the position among arrays by its name.
///
/// Tries the shape (N, 3) or three arrays of N numbers first, then (3, N), then (T, N, 3). An array
/// of shape (3, 3) has three particles. Every other array with the same number of particles is an
/// attribute.
///
/// A single array called `pos` or similar is preferred to three arrays `x`, `y` and `z`, which may
/// be the axes of a grid.
///
/// Returns `None` if no array is a position.
///
/// # Errors
/// [`ReadFault::Malformed`] if the position consists of arrays of different lengths.
pub fn arrange(fields: &[NamedArray]) -> Result<Option<Arrangement>, ReadFault> {
    let mut separate = None;
    for axes in [Axes::Particles, Axes::Components, Axes::Frames] {
        match (arrange_along(fields, axes).transpose(), &separate) {
            (None, _) => {}
            (Some(Ok(found)), None) if !found.position.name.is_empty() => return Ok(Some(found)),
            (Some(found), None) => separate = Some(found),
            (Some(Ok(found)), Some(_)) if is_preferred_position(&found.position.name) => {
                return Ok(Some(found));
            }
            _ => {}
        }
    }
    separate.transpose()
}

/// Whether a field is one of three arrays `x`, `y` and `z` of equal shape. Such an array is not a
/// vector, because its axes may be frames and particles.
fn is_one_axis(fields: &[NamedArray], field: usize) -> bool {
    const AXES: [&str; 3] = ["x", "y", "z"];
    let NamedArray { name, shape } = &fields[field];
    let lower = name.to_ascii_lowercase();
    let axes_in_name: Vec<_> = AXES.into_iter().filter(|axis| lower.contains(axis)).collect();
    let has = |axis: &str| {
        let name = lower.replace(axes_in_name[0], axis);
        fields.iter().any(|f| f.name.eq_ignore_ascii_case(&name) && f.shape == *shape)
    };
    axes_in_name.len() == 1 && AXES.into_iter().all(has)
}

fn arrange_along(fields: &[NamedArray], axes: Axes) -> Result<Option<Arrangement>, ReadFault> {
    let mut candidates = NamedColumns::of(fields);
    for (number, NamedArray { shape, .. }) in fields.iter().enumerate() {
        let Some(extent) = axes.extent(shape) else { continue };
        // Arrays of shape (T, N) called x, y and z are not used as positions, because it is unknown
        // whether their axes are frames and particles, or the two axes of a grid.
        let may_be_position = match axes {
            Axes::Particles => shape.len() <= 2,
            Axes::Components => true,
            Axes::Frames => shape.len() == 3,
        };
        if may_be_position {
            candidates.push(number, extent.components);
        }
    }
    let Some((position, _)) = candidates.position() else { return Ok(None) };
    let extent = |field: usize| axes.extent(&fields[field].shape).expect("it was computed above");
    let ArrayExtent { frames, rows, .. } = extent(position.places[0].field);
    let fits_position = |other: &ArrayExtent| other.rows == rows && other.frames == frames;
    if !position.places.iter().all(|place| fits_position(&extent(place.field))) {
        let names = position.places.iter().map(|place| {
            let NamedArray { name, shape } = &fields[place.field];
            format!("{name} {}", shown(shape))
        });
        let names: Vec<_> = names.collect();
        let what = format!("the arrays with the positions differ in length: {}", names.join(", "));
        return Err(malformed(0, what));
    }
    // For each array, try the axes of the position first, and then axes without frames. The values
    // of an array without frames apply to every frame.
    let mut columns = NamedColumns::of(fields);
    let (mut left_out, mut separate) = (Vec::new(), Vec::new());
    let mut chosen = vec![Axes::Particles; fields.len()];
    for (number, NamedArray { name, shape }) in fields.iter().enumerate() {
        let fitting = [axes, Axes::Particles, Axes::Components].into_iter().find_map(|axes| {
            let extent = axes.extent(shape)?;
            let fits = extent.rows == rows && (extent.frames.is_none() || extent.frames == frames);
            fits.then_some((axes, extent))
        });
        if let Some((axes, extent)) = fitting {
            chosen[number] = axes;
            columns.push(number, extent.components);
        } else if let Some(numbers) = excessive_components(shape, rows, frames) {
            left_out.push(UnreadPart::WideArray { name: name.clone(), numbers });
        } else if ["x", "y", "z"].iter().any(|axis| name.eq_ignore_ascii_case(axis)) {
            separate.push((name, shape));
        } else {
            left_out.extend(other_shape(name, shape, rows, frames));
        }
    }
    if let [(x, _), (y, _), (z, _)] = separate[..] {
        let names = [x, y, z].map(String::clone);
        left_out.push(UnreadPart::Coordinates { names, position: position.name });
    } else {
        let parts = separate.into_iter();
        left_out.extend(parts.filter_map(|(name, shape)| other_shape(name, shape, rows, frames)));
    }
    let found = columns.position();
    Ok(found.map(|(position, attributes)| Arrangement {
        rows,
        frames,
        axes: chosen,
        position,
        attributes,
        left_out,
    }))
}

/// The report that an array does not match the number of particles. `None` for arrays that belong
/// to whole frames: times, arrays of at most three numbers, such as a vector of gravity, and arrays
/// of one number per frame.
pub fn other_shape(
    name: &str,
    shape: &[u64],
    particles: u64,
    frames: Option<u64>,
) -> Option<UnreadPart> {
    let numbers = shape.iter().fold(1, |product: u64, &size| product.saturating_mul(size));
    let is_per_frame = frames.is_some_and(|frames| *shape == [frames]);
    let is_of_frames = numbers <= 3 || is_per_frame || time_arrays().any(|time| time == name);
    let (name, shape) = (name.to_owned(), shape.to_vec());
    (!is_of_frames).then_some(UnreadPart::OtherShape { name, shape, particles, frames })
}

/// The number of values per particle of an array, if this number exceeds [`MOST_COMPONENTS`].
fn excessive_components(shape: &[u64], rows: u64, frames: Option<u64>) -> Option<u64> {
    let axes = match *shape {
        [first, second, ref axes @ ..] if Some(first) == frames && second == rows => axes,
        [first, ref axes @ ..] if first == rows => axes,
        [ref axes @ .., last] if last == rows => axes,
        _ => return None,
    };
    let numbers = axes.iter().fold(1, |product: u64, &size| product.saturating_mul(size));
    (numbers > MOST_COMPONENTS).then_some(numbers)
}

/// The index of the only array of shape (N, 3), or else (3, N), or else (T, N, 3). Ignores arrays
/// whose names suggest other vectors, such as velocities.
pub fn only_vector(fields: &[NamedArray]) -> Option<usize> {
    let is_other = |name: &str| {
        let name = name.to_ascii_lowercase();
        let stem = name.rsplit(['_', '/', '.']).find(|part| !part.is_empty()).unwrap_or(&name);
        matches!(stem, "a" | "b" | "e" | "f" | "n" | "u" | "v" | "w" | "cd" | "rgb")
            || velocity_rank(&name).is_some()
            || NON_POSITION_PREFIXES.iter().any(|other| stem.starts_with(other))
    };
    [Axes::Particles, Axes::Components, Axes::Frames].into_iter().find_map(|axes| {
        let vectors = fields.iter().enumerate().filter(|(_, NamedArray { name, shape })| {
            let rank = if axes == Axes::Frames { 3 } else { 2 };
            shape.len() == rank && axes.components(shape) == 3 && !is_other(name)
        });
        match vectors.map(|(number, _)| number).collect::<Vec<_>>()[..] {
            [only] => Some(only),
            _ => None,
        }
    })
}

/// Advice for arrays that would contain positions if there were a third coordinate. `None` for
/// other arrays. `arranged` is the function that finds the position, such as [`arrange`].
pub fn advice_on_plane(
    fields: &[NamedArray],
    arranged: impl Fn(&[NamedArray]) -> Result<Option<Arrangement>, ReadFault>,
) -> Option<String> {
    let mut solid = fields.to_vec();
    for NamedArray { shape, .. } in &mut solid {
        match shape[..] {
            [_, .., ref mut size @ 2] | [ref mut size @ 2, _] => *size = 3,
            _ => {}
        }
    }
    let is_y = |name: &str| position_axis(name) == Some(1) && name.ends_with(['y', 'Y']);
    for NamedArray { name, shape } in fields.iter().filter(|field| is_y(&field.name)) {
        let z = if name.ends_with('y') { "z" } else { "Z" };
        let name = format!("{}{z}", &name[..name.len() - 1]);
        solid.push(NamedArray { name, shape: shape.clone() });
    }
    let position = arranged(&solid).ok()??.position;
    let zeros = match position.places.iter().find(|place| place.field >= fields.len()) {
        Some(z) => {
            let [y, z] = [position.places[1].field, z.field].map(|field| &solid[field].name);
            format!("save zeros as {z}: np.zeros_like({y})")
        }
        None => {
            let NamedArray { name, shape } = &fields[position.places[0].field];
            zeros_as_z(name, shape)?
        }
    };
    Some(format!("for particles in a plane, {zeros}"))
}

/// Advice to add zeros as the third coordinate of an array with this name. `None` for an array
/// without two coordinates.
pub fn zeros_as_z(name: &str, shape: &[u64]) -> Option<String> {
    let (zeros, padding) = match *shape {
        [_, 2] => ("column", "((0, 0), (0, 1))"),
        [2, _] => ("row", "((0, 1), (0, 0))"),
        [_, _, 2] => ("column", "((0, 0), (0, 0), (0, 1))"),
        _ => return None,
    };
    Some(format!("add a {zeros} of zeros: np.pad({name}, {padding})"))
}

/// The shape of an array in Python's notation.
pub fn shown(shape: &[u64]) -> String {
    match shape {
        [one] => format!("({one},)"),
        _ => format!("({})", shape.iter().map(u64::to_string).collect::<Vec<_>>().join(", ")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fields(all: &[(&str, &[u64])]) -> Vec<NamedArray> {
        all.iter()
            .map(|(name, shape)| NamedArray { name: (*name).to_owned(), shape: shape.to_vec() })
            .collect()
    }

    #[test]
    fn the_first_axis_counts_particles_if_both_axes_fit() {
        let found = |shape: &[u64]| {
            let arranged = arrange(&fields(&[("pos", shape)])).unwrap();
            arranged.map(|a| (a.axes[0], a.rows, a.frames))
        };
        assert_eq!(found(&[3, 3]), Some((Axes::Particles, 3, None)));
        assert_eq!(found(&[3, 9]), Some((Axes::Components, 9, None)));
        assert_eq!(found(&[3, 9, 3]), Some((Axes::Frames, 9, Some(3))));
        assert_eq!(found(&[5, 1, 3]), Some((Axes::Frames, 1, Some(5))));
        assert_eq!(found(&[9, 6]), None);
    }

    #[test]
    fn attributes_match_the_particle_count_along_any_axis() {
        let all = fields(&[
            ("C", &[9, 20]),
            ("F", &[20, 3, 3]),
            ("time", &[1]),
            ("v", &[3, 20]),
            ("volume", &[20]),
            ("x", &[3, 20]),
        ]);
        let arranged = arrange(&all).unwrap().unwrap();
        let names: Vec<_> =
            arranged.attributes.iter().map(|f| (&*f.name, f.places.len())).collect();
        assert_eq!(names, [("v", 3), ("volume", 1), ("C", 9), ("F", 9)]);
        assert_eq!((arranged.rows, &*arranged.position.name), (20, "x"));
    }

    #[test]
    fn an_array_of_positions_is_preferred_to_separate_coordinates() {
        let found = |all: &[(&str, &[u64])]| {
            let found = arrange(&fields(all)).unwrap().unwrap();
            let attributes = found.attributes.into_iter().map(|f| (f.name, f.places.len()));
            (found.position.name, found.rows, attributes.collect(), found.left_out)
        };
        let of = |axes: [u64; 3], name, shape: &[u64]| {
            found(&[("x", &axes[..1]), ("y", &axes[1..2]), ("z", &axes[2..]), (name, shape)])
        };
        let axes = || UnreadPart::Coordinates {
            names: ["x", "y", "z"].map(String::from),
            position: "pos".into(),
        };
        let pos = |rows| ("pos".into(), rows, vec![], vec![axes()]);
        assert_eq!(of([8, 8, 8], "pos", &[20, 3]), pos(20));
        assert_eq!(of([8, 9, 10], "pos", &[20, 3]), pos(20));
        assert_eq!(of([8, 8, 8], "pos", &[3, 20]), pos(20));
        assert_eq!(of([8, 9, 10], "pos", &[2, 20, 3]), pos(20));
        assert_eq!(
            of([20, 20, 20], "Coordinates", &[20, 3]),
            ("Coordinates".into(), 20, vec![("xyz".into(), 3)], vec![])
        );
        // The array `p` is not read as the position, because it may be a momentum.
        let separate =
            |name: &str, components| ("".into(), 20, vec![(name.to_owned(), components)], vec![]);
        assert_eq!(of([20, 20, 20], "p", &[20, 3]), separate("p", 3));
        assert_eq!(of([20, 20, 20], "p", &[3, 20]), separate("p", 3));
    }

    #[test]
    fn coordinates_with_an_axis_for_frames_are_not_a_vector() {
        for shape in [[3, 20], [20, 3], [3, 3]] {
            let all = fields(&[("x", &shape), ("y", &shape), ("z", &shape), ("m", &[20])]);
            assert!(arrange(&all).unwrap().is_none(), "{shape:?}");
            assert_eq!(only_vector(&all), None);
        }
        let of_each_axis = fields(&[("x", &[20, 3]), ("y", &[20]), ("z", &[20])]);
        assert_eq!(arrange(&of_each_axis).unwrap().unwrap().position.name, "x");
    }

    #[test]
    fn positions_in_a_plane_lead_to_advice_on_the_missing_zeros() {
        let advice = |all: &[(&str, &[u64])]| advice_on_plane(&fields(all), arrange);
        for (all, expected) in [
            (&[("pos", &[50, 2][..]), ("m", &[50])][..], "np.pad(pos, ((0, 0), (0, 1)))"),
            (&[("pos", &[2, 50])], "np.pad(pos, ((0, 1), (0, 0)))"),
            (&[("x", &[5, 50, 2])], "np.pad(x, ((0, 0), (0, 0), (0, 1)))"),
            (&[("x", &[50]), ("y", &[50]), ("vx", &[50])], "as z: np.zeros_like(y)"),
            (&[("pos_x", &[50]), ("pos_y", &[50])], "as pos_z: np.zeros_like(pos_y)"),
        ] {
            assert!(advice(all).unwrap().ends_with(expected), "{all:?}");
        }
        for all in [
            &[("vel", &[50, 2][..])][..],
            &[("vx", &[50]), ("vy", &[50])],
            &[("x", &[8]), ("y", &[9])],
            &[("x", &[8, 9]), ("y", &[8, 9])],
        ] {
            assert_eq!(advice(all), None, "{all:?}");
        }
    }

    #[test]
    fn grids_and_velocities_are_not_taken_for_positions() {
        let grid = fields(&[("x", &[8, 8]), ("y", &[8, 8]), ("z", &[8, 8])]);
        assert!(arrange(&grid).unwrap().is_none());
        let axes = fields(&[("x", &[8]), ("y", &[9]), ("z", &[10])]);
        assert!(matches!(arrange(&axes), Err(ReadFault::Malformed { .. })));
        assert_eq!(only_vector(&fields(&[("vel", &[8, 3])])), None);
        assert_eq!(only_vector(&fields(&[("arr_0", &[8, 3]), ("grid_v", &[8, 3])])), Some(0));
    }
}
