//! See `mod.rs` of this folder for the formulas.

use glam::IVec3;
use multiversion::multiversion;

use crate::brick::Block;
use crate::field::distance::{greatest_of, spread};
use crate::grid::CellBox;

use super::logarithm::{exp2, log2};
use super::{
    BEYOND, BEYOND_IF_FLAT, BITS, BY_RIM, FLAT, IMPURE, IMPURE_IF_FLAT, IN_BULK, LEAST_WEIGHT,
    LOG2_OF_E, Loose, ONE, ROUND, SheetConstants, SheetFields, Sheets, THICK, THIN, WEIGHT_BITS,
};

/// Number of cells that are processed at a time.
const LANES: usize = 16;

/// The limit for components of g and of products of B with a vector.
const MOST_SLOPE: i32 = 4 * ONE;
/// The limit for entries of matrices such as B, and for components of the offset to the middle.
const MOST_BEND: i32 = 2 * ONE;

/// Whether `clouds` can hold a sheet, which needs more than one particle.
pub fn holds_any(sheets: &Sheets, clouds: &Block) -> bool {
    let mut sum = 0;
    for samples in clouds.samples().chunks(1 << 10) {
        sum += samples.iter().map(|&sample| u32::from(sample)).sum::<u32>();
        if sum > sheets.least {
            return true;
        }
    }
    false
}

/// Reduces clouds in the bulk, on the cells of `smooth`. `smooth` are the clouds after smoothing by
/// the filter that shows the bulk; `scale` converts them to fractions of the plateau.
///
/// # Panics
/// If `clouds` does not cover `smooth`.
pub fn loose(clouds: &Block, mut smooth: Block, scale: u32) -> Loose<Block> {
    let mut clouds = clouds.part(smooth.cells());
    if (u32::from(greatest_of(smooth.samples())) * scale) >> 14 <= IN_BULK.begin.into() {
        return Loose { clouds, weights: None };
    }
    weigh(clouds.samples_mut(), smooth.samples_mut(), scale);
    Loose { clouds, weights: Some(smooth) }
}

/// Replaces the smoothed clouds with weights, by which the clouds are multiplied.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2", "x86_64+sse4.1"))]
fn weigh(clouds: &mut [u16], smooth: &mut [u16], scale: u32) {
    for (cloud, smooth) in clouds.iter_mut().zip(smooth) {
        let density = ((u32::from(*smooth) * scale) >> 14).min(u16::MAX.into()) as u16;
        let weight = 4096 - IN_BULK.of(density);
        *cloud = ((u32::from(*cloud) * weight) >> 12) as u16;
        *smooth = (weight.max(LEAST_WEIGHT) << (WEIGHT_BITS - BITS)) as u16;
    }
}

/// Finds the sheets of the smoothed density on `cells`; returns `None` if there are no sheets.
/// Beyond the cells of `density`, the density counts as too low for sheets. If `needed` is given,
/// certainty is computed only where `needed` is nonzero. Shares are valid only near cells of
/// nonzero certainty, within the reach of the averaging filter.
///
/// # Panics
/// If `needed` does not cover `cells`, or if `density` does not extend one step beyond each of the
/// `cells` that is dense enough for a sheet.
pub fn sheets(
    by: &Sheets,
    density: &Block,
    cells: CellBox,
    needed: Option<&Block>,
) -> Option<SheetFields<Block>> {
    let numbers = &by.numbers;
    let step = numbers.step;
    // Logarithms are only needed around samples that reach the minimum.
    let least = by.least_density();
    let dense = density.box_of(|sample| sample >= least).intersection(&cells);
    if dense.is_empty() {
        return None;
    }
    let density = density.part(dense.grown(step, step));
    let (mut shares, mut certainty) = (Block::zero(cells), Block::zero(cells));
    // Several cells are processed at a time, even at the end of the last row, so there are more
    // logarithms than samples.
    let mut logarithms = vec![0; density.samples().len() + LANES];
    logarithms_of(&mut logarithms, density.samples());
    let strides = density.strides().map(|stride| stride as isize * step as isize);
    let [x, y, z] = strides;
    let width = dense.size().x as usize;
    let mut candidates = vec![0; width];
    // For each piece of a row, whether its sheets were computed.
    let in_row = width.div_ceil(LANES);
    let mut computed = vec![false; density.rows(dense).count() * in_row];
    let mut any = false;
    for (([y_cell, z_cell], _), computed) in density.rows(dense).zip(computed.chunks_mut(in_row)) {
        let row = IVec3::new(dense.lo.x, y_cell, z_cell);
        let (first, to) = (density.index(row), shares.index(row));
        let needed = needed.map(|needed| &needed.samples()[needed.index(row)..][..width]);
        if needed.is_some_and(|needed| greatest_of(needed) == 0) {
            continue;
        }
        let row = |offset: isize| &logarithms[first.wrapping_add_signed(offset)..][..width];
        let neighbours = [row(-x), row(x), row(-y), row(y), row(-z), row(z)];
        may_be_sheets(&mut candidates, numbers, row(0), neighbours);
        for (candidate, &needed) in candidates.iter_mut().zip(needed.into_iter().flatten()) {
            *candidate &= u16::from(needed > 0);
        }
        let pieces = candidates.chunks(LANES).zip(computed).zip((0..).step_by(LANES));
        for ((piece, computed), start) in
            pieces.filter(|((candidates, _), _)| greatest_of(candidates) > 0)
        {
            *computed = true;
            let found = sheets_of_each(numbers, &logarithms, first + start, strides);
            let place = to + start..to + start + piece.len();
            shares.samples_mut()[place.clone()].copy_from_slice(&found.0[..piece.len()]);
            certainty.samples_mut()[place].copy_from_slice(&found.1[..piece.len()]);
            any |= greatest_of(&found.1[..piece.len()]) > 0;
        }
    }
    if !any {
        return None;
    }

    let reach = by.average.reach();
    let mut near = Block::zero(cells.grown(reach, reach));
    near.put(&certainty);
    let near = spread(near, reach);
    for (([y_cell, z_cell], near), computed) in near.rows(dense).zip(computed.chunks(in_row)) {
        let row = IVec3::new(dense.lo.x, y_cell, z_cell);
        let (first, to) = (density.index(row), shares.index(row));
        let pieces = near.chunks(LANES).zip(computed).zip((0..).step_by(LANES));
        for ((piece, _), start) in
            pieces.filter(|((certain, computed), _)| !**computed && greatest_of(certain) > 0)
        {
            let (found, _) = sheets_of_each(numbers, &logarithms, first + start, strides);
            shares.samples_mut()[to + start..][..piece.len()]
                .copy_from_slice(&found[..piece.len()]);
        }
    }
    Some(SheetFields { shares, certainty })
}

#[multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2", "x86_64+sse4.1"))]
fn logarithms_of(to: &mut [u16], samples: &[u16]) {
    for (to, &sample) in to.iter_mut().zip(samples) {
        *to = log2(sample) as u16;
    }
}

/// For each logarithm of a row: 1 if it may belong to a sheet, according to its neighbours along
/// the axes, and 0 otherwise.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2", "x86_64+sse4.1"))]
fn may_be_sheets(to: &mut [u16], numbers: &SheetConstants, row: &[u16], neighbours: [&[u16]; 6]) {
    let [x, to_x, y, to_y, z, to_z] = neighbours;
    let (x, y, z) = (x.iter().zip(to_x), y.iter().zip(to_y), z.iter().zip(to_z));
    for ((to, &centre), ((x, y), z)) in to.iter_mut().zip(row).zip(x.zip(y).zip(z)) {
        let centre = i32::from(centre);
        let second = |(&a, &b): (&u16, &u16)| 2 * centre - i32::from(a) - i32::from(b);
        let seconds = [second(x), second(y), second(z)];
        let is_thin = seconds[0] + seconds[1] + seconds[2] > numbers.least_across;
        *to = u16::from((centre >= numbers.least) & is_thin & !numbers.is_round(seconds));
    }
}

/// Sheets at several adjacent cells at a time, as in [`SheetConstants::sheet`]. The three strides
/// lead from a cell to the samples from which the cell's differences are computed.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2", "x86_64+sse4.1"))]
fn sheets_of_each(
    numbers: &SheetConstants,
    logarithms: &[u16],
    first: usize,
    [x, y, z]: [isize; 3],
) -> ([u16; LANES], [u16; LANES]) {
    let at = |offset: isize| -> &[u16; LANES] {
        let taps = logarithms[first.wrapping_add_signed(offset)..].first_chunk();
        taps.expect("there are enough samples beyond the last row")
    };
    let (centre, below, above) = (at(0), [at(-x), at(-y), at(-z)], [at(x), at(y), at(z)]);
    let same = [[at(x + y), at(-x - y)], [at(x + z), at(-x - z)], [at(y + z), at(-y - z)]];
    let opposite = [[at(x - y), at(y - x)], [at(x - z), at(z - x)], [at(y - z), at(z - y)]];
    let (mut shares, mut certainty) = ([0; LANES], [0; LANES]);
    for lane in 0..LANES {
        let one = |taps: &[u16; LANES]| i32::from(taps[lane]);
        let sum = |[a, b]: [&[u16; LANES]; 2]| one(a) + one(b);
        (shares[lane], certainty[lane]) = numbers.sheet(&Taps {
            centre: one(centre),
            below: [one(below[0]), one(below[1]), one(below[2])],
            above: [one(above[0]), one(above[1]), one(above[2])],
            same: [sum(same[0]), sum(same[1]), sum(same[2])],
            opposite: [sum(opposite[0]), sum(opposite[1]), sum(opposite[2])],
        });
    }
    (shares, certainty)
}

/// Blends the shares of drops with the shares of sheets, weighted by the certainty of the sheets.
///
/// # Panics
/// If a field of sheets does not cover the drops.
pub fn blend(mut drops: Block, sheets: &Block, certainty: &Block) -> Block {
    let cells = drops.cells();
    let width = cells.size().x as usize;
    let rows = sheets.rows(cells).zip(certainty.rows(cells));
    for (shares, ((_, of_sheets), (_, certainty))) in
        drops.samples_mut().chunks_exact_mut(width).zip(rows)
    {
        for ((share, &sheet), &certain) in shares.iter_mut().zip(of_sheets).zip(certainty) {
            if certain > 0 {
                let drop = i32::from(*share);
                let more = ((i32::from(sheet) - drop) * i32::from(certain)) >> BITS;
                *share = (drop + more) as u16;
            }
        }
    }
    drops
}

/// Logarithms of the density around a cell.
struct Taps {
    centre: i32,
    /// One step down along x, y and z.
    below: [i32; 3],
    above: [i32; 3],
    /// For each of the planes xy, xz and yz, the sum of the two ends of the diagonal on which both
    /// coordinates change in the same direction.
    same: [i32; 3],
    /// For each of these planes, the sum of the two ends of the other diagonal, on which the
    /// coordinates change in opposite directions.
    opposite: [i32; 3],
}

#[inline(always)]
fn dot(a: [i32; 3], b: [i32; 3]) -> i32 {
    (a[0] * b[0] + a[1] * b[1] + a[2] * b[2]) / ONE
}

impl SheetConstants {
    /// A diagonal entry of the matrix B (see `mod.rs`), from the second difference along the same
    /// axis.
    #[inline(always)]
    fn bend(&self, second: i32) -> i32 {
        (second.clamp(-8 * ONE, 8 * ONE) * self.bend / ONE).clamp(-MOST_BEND, MOST_BEND)
    }

    /// Whether the second differences along the axes indicate a drop, which is not a sheet.
    #[inline(always)]
    fn is_round(&self, seconds: [i32; 3]) -> bool {
        let [x, y, z] = seconds.map(|second| self.bend(second));
        x + y + z >= i32::from(ROUND.begin) + i32::from(ROUND.range)
    }

    /// The share and the certainty of a sheet at a cell.
    #[inline(always)]
    fn sheet(&self, taps: &Taps) -> (u16, u16) {
        let slope = |axis: usize| {
            let difference = (taps.above[axis] - taps.below[axis]).clamp(-4 * ONE, 4 * ONE);
            (difference * self.slope / ONE).clamp(-MOST_SLOPE, MOST_SLOPE)
        };
        let bend = |axis: usize| self.bend(2 * taps.centre - taps.above[axis] - taps.below[axis]);
        let twist = |plane: usize| {
            let second = taps.opposite[plane] - taps.same[plane];
            (second.clamp(-8 * ONE, 8 * ONE) * self.bend / (4 * ONE)).clamp(-MOST_BEND, MOST_BEND)
        };
        let g = [slope(0), slope(1), slope(2)];
        let [xx, yy, zz] = [bend(0), bend(1), bend(2)];
        let [xy, xz, yz] = [twist(0), twist(1), twist(2)];
        let b = [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]];
        let times = |v: [i32; 3]| {
            [dot(b[0], v), dot(b[1], v), dot(b[2], v)].map(|x| x.clamp(-MOST_SLOPE, MOST_SLOPE))
        };

        // The squared distance of B from a projection.
        let mut impure = 0;
        for i in 0..3 {
            for j in 0..3 {
                let apart = (b[i][j] - dot(b[i], b[j])).clamp(-MOST_BEND, MOST_BEND);
                impure += apart * apart;
            }
        }
        let impure = (impure >> BITS).min(u16::MAX.into());
        let directions = (xx + yy + zz).clamp(0, 3 * ONE);
        let (narrow, rounded) = ((directions - ONE).clamp(0, ONE), (directions - 2 * ONE).max(0));
        let rim = (impure * BY_RIM).min(ONE).max(narrow);

        // det(I - B).
        let [x, y, z] = [ONE - xx, ONE - yy, ONE - zz];
        let minor = |a: [i32; 2], b: [i32; 2]| (a[0] * b[0] - a[1] * b[1]) / ONE;
        let determinant = (x * minor([y, yz], [z, yz])
            - xy * minor([xy, -yz], [z, xz])
            - xz * minor([xz, -yz], [y, xy]))
            >> BITS;
        let determinant = determinant.clamp(0, u16::MAX.into()) as u16;
        let flat = 4096 - FLAT.of(determinant) as i32;
        let impure = (impure - ((IMPURE_IF_FLAT * flat) >> BITS)).max(0) as u16;

        let along = times(g);
        let twice = times(along);
        let middle =
            [0, 1, 2].map(|i: usize| (2 * along[i] - twice[i]).clamp(-MOST_BEND, MOST_BEND));
        let away = dot(middle, middle);
        let beyond = ((4 * dot(g, g) - 3 * dot(g, along)) >> 1).clamp(0, u16::MAX.into());
        let more = beyond.min(self.most_more);
        let density = taps.centre + ((more * LOG2_OF_E) >> BITS) - self.plateau;

        let [sheet, filament] = self.stretches;
        let power = ONE / 2 + narrow / 2;
        let stretch = sheet + (((filament - sheet) * narrow) >> BITS) - ((density * power) >> BITS);
        let stretch = stretch.clamp(0, u16::MAX.into()) as u16;
        let passed = |share: u32, ramp: u32| (share * ramp) >> BITS;
        let still_beyond = (beyond - ((BEYOND_IF_FLAT * flat) >> BITS)).max(0) as u16;
        let certain = passed(
            passed(4096 - self.torn.of(stretch), 4096 - IMPURE.of(impure)),
            passed(
                passed(THIN.of(directions as u16), 4096 - ROUND.of(directions as u16)),
                4096 - BEYOND.of(still_beyond),
            ),
        );
        let certain = passed(certain, 4096 - THICK.of(determinant));
        // The certainty is squared, because pieces of uncertain sheets would be visible otherwise.
        let certain = passed(certain, certain);

        let [sheet, filament, round] = self.sizes;
        let power = 2 * ONE - narrow - rounded / 3;
        let size = ((density * power) >> BITS)
            + sheet
            + (((filament - sheet) * narrow + (round - filament) * rounded) >> BITS);
        let least_size = self.least_size + ((self.rim * rim) >> BITS);
        let closer = (self.gradual - (size - least_size).abs()).max(0);
        let size = size.max(least_size) + ((((closer * closer) >> BITS) * self.by_gradual) >> BITS);
        let size = exp2(size.min(ONE)) >> 3;
        let share = self.share
            + ((self.by_directions * directions.clamp(ONE, 3 * ONE) + self.by_size * size
                - self.by_distance * away)
                >> BITS);
        let share = exp2(share.clamp(-15 * ONE, ONE - 1)) as u16;
        // There is no early return for low densities, because several cells are processed at a
        // time.
        (if taps.centre < self.least { 0 } else { share }, certain as u16)
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::{LOG2_E, PI, TAU};

    use glam::DVec3;

    use super::*;
    use crate::field::indicator::WideCells;
    use crate::field::sheets::DropShape;
    use crate::grid::units::SheetStretch;

    const CELL: f64 = 0.5;
    const WIDE: WideCells = WideCells { level: 2, edge: 1.0 };
    const DROPS: DropShape = DropShape { radius: 0.5, width: 0.6, spline: 0.0 };

    fn default_sheets() -> Sheets {
        let sheets = Sheets::new(SheetStretch::DEFAULT, [0.25, CELL], WIDE, DROPS);
        sheets.expect("there are sheets")
    }

    /// The standard deviation of a particle in the density that shows sheets. It includes the
    /// widths of the filter, the clouds and the spline.
    fn width() -> f64 {
        let (variance, _) = default_sheets().around.before_cut();
        (variance + 0.5).sqrt() * WIDE.edge
    }

    /// The density, as a fraction of the plateau, in the middle of a sheet one spacing thick.
    fn peak() -> f64 {
        let (_, higher) = default_sheets().around.before_cut();
        higher / (TAU.sqrt() * width())
    }

    /// The share and the certainty of a sheet at `place`. `logarithm` gives the binary logarithm of
    /// the density, relative to the plateau, at any place.
    fn sheet_at(place: DVec3, logarithm: impl Fn(DVec3) -> f64) -> (u16, u16) {
        let numbers = default_sheets().numbers;
        let step = f64::from(numbers.step) * CELL;
        let at = |x: i32, y: i32, z: i32| {
            let place = place + DVec3::new(x.into(), y.into(), z.into()) * step;
            numbers.plateau + (logarithm(place) * f64::from(ONE)).round() as i32
        };
        numbers.sheet(&Taps {
            centre: at(0, 0, 0),
            below: [at(-1, 0, 0), at(0, -1, 0), at(0, 0, -1)],
            above: [at(1, 0, 0), at(0, 1, 0), at(0, 0, 1)],
            same: [
                at(1, 1, 0) + at(-1, -1, 0),
                at(1, 0, 1) + at(-1, 0, -1),
                at(0, 1, 1) + at(0, -1, -1),
            ],
            opposite: [
                at(1, -1, 0) + at(-1, 1, 0),
                at(1, 0, -1) + at(-1, 0, 1),
                at(0, 1, -1) + at(0, -1, 1),
            ],
        })
    }

    /// The share at `away` spacings from the middle of a thin body, minus the share on a drop's
    /// surface. The body is thin along the axes `across`, and its density is `density` times the
    /// plateau.
    fn beyond_surface(across: &[DVec3], density: f64, away: f64) -> f64 {
        let (share, certain) = sheet_at(across[0] * away, |place| {
            let squared: f64 = across.iter().map(|axis| axis.dot(place).powi(2)).sum();
            density.log2() - squared / (2.0 * width() * width()) * LOG2_E
        });
        let surface = (-0.5 * (DROPS.radius / DROPS.width).powi(2)).exp() * 32768.0;
        f64::from(share) * f64::from(certain) / f64::from(ONE) - surface
    }

    /// The distance of the surface from the middle of a thin body, in spacings.
    fn half_thickness(across: &[DVec3], density: f64) -> f64 {
        let inside = (0..200).map(|i| 0.01 * f64::from(i));
        inside.take_while(|&away| beyond_surface(across, density, away) > 0.0).last().unwrap_or(0.0)
    }

    /// A half thickness or radius that approaches its minimum gradually, in cells of a quarter of a
    /// spacing.
    fn with_minimum(own: f64, least: f64) -> f64 {
        let [own, least] = [own, least].map(|size| 2.0 * size.log2());
        let closer = (2.2 - (own - least).abs()).max(0.0);
        (0.5 * (own.max(least) + closer * closer / 8.8)).exp2()
    }

    #[test]
    fn sheets_and_filaments_have_their_thickness_in_any_orientation() {
        let normal = DVec3::new(0.36, 0.48, 0.8);
        let other = normal.any_orthonormal_vector();
        for [first, second] in [[DVec3::Y, DVec3::X], [normal, other], [other, normal]] {
            for thickness in [0.26, 0.3, 0.4, 0.7, 0.9] {
                let expected = with_minimum(0.5 * thickness, 0.205);
                let found = half_thickness(&[first], thickness * peak());
                assert!((found - expected).abs() < 0.03, "{first} {thickness}: {found}");
            }
            for area in [0.5, 1.0] {
                let expected = with_minimum((area / PI).sqrt(), 0.2625);
                let found = half_thickness(&[first, second], area * peak().powi(2));
                assert!((found - expected).abs() < 0.03, "{first} {area}: {found}");
            }
            // Particles that are three spacings apart make no sheet, and a single particle makes no
            // sheet.
            assert_eq!(half_thickness(&[first], peak() / 9.0), 0.0);
            let third = first.cross(second);
            assert_eq!(half_thickness(&[first, second, third], peak().powi(3)), 0.0);
        }
    }

    /// The binary logarithm of the smoothed density at `x`, relative to the plateau, if the half
    /// space x < 0 is full of fluid.
    fn half(x: f64) -> f64 {
        (0.5 * libm::erfc(x / width() / 2.0_f64.sqrt())).log2()
    }

    #[test]
    fn clouds_in_the_bulk_have_no_weight_and_elsewhere_stay_as_they_are() {
        let row = CellBox { lo: IVec3::ZERO, hi: IVec3::new(4, 1, 1) };
        let block = |samples: [u16; 4]| {
            let mut block = Block::zero(row);
            block.samples_mut().copy_from_slice(&samples);
            block
        };
        // With this scale, a plateau is 32768.
        let scale = 1 << 14;
        let [outside, between] = [IN_BULK.begin, IN_BULK.begin + IN_BULK.range / 2];
        let found = loose(&block([8000; 4]), block([0, outside, between, 20000]), scale);
        assert_eq!(found.clouds.samples(), [8000, 8000, 4000, 0]);
        let least = (LEAST_WEIGHT << 3) as u16;
        assert_eq!(found.weights.unwrap().samples(), [32768, 32768, 16384, least]);
        let free = loose(&block([8000; 4]), block([0, 0, 0, outside]), scale);
        assert!(free.weights.is_none() && free.clouds.samples() == [8000; 4]);
    }

    #[test]
    fn sheets_reach_their_corners_and_thick_bodies_are_not_sheets() {
        let gaussian = |x: f64| -x * x / (2.0 * width() * width()) * LOG2_E;
        let stretched = |stretch: f64| (stretch.powi(-2) * peak()).log2();
        let certainty =
            |place: DVec3, logarithm: &dyn Fn(DVec3) -> f64| sheet_at(place, logarithm).1;
        let corner = |p: DVec3| stretched(1.6) + gaussian(p.z) + half(p.x) + half(p.y);
        assert!(certainty(DVec3::new(-20.0, -20.0, 0.0), &corner) > 4000);
        // The outermost particles lie inside the edges, by half the distance between particles.
        assert!(certainty(DVec3::new(-0.8, -20.0, 0.0), &corner) > 3000);
        assert!(certainty(DVec3::new(-0.8, -0.8, 0.0), &corner) > 2000);
        // The surface of the bulk is not a sheet, not even at an edge of the bulk.
        for outside in [-0.5, 0.0, 0.5] {
            assert_eq!(certainty(DVec3::splat(outside), &|p| half(p.x)), 0);
            assert_eq!(certainty(DVec3::splat(outside), &|p| half(p.x) + half(p.y)), 0);
        }
        // The cluster has as many particles as the corner, but they are spread in all directions.
        let wide = |x: f64| gaussian(x) * 0.5;
        let cluster = |p: DVec3| stretched(1.6) - 2.0 + wide(p.x) + wide(p.y) + wide(p.z);
        assert_eq!(certainty(DVec3::ZERO, &cluster), 0);
    }
}
