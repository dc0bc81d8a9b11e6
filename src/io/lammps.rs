//! Reads LAMMPS dumps in text. Each step has a box, and one row per atom.
//!
//! The columns of the position are `x y z`, else `xu yu zu`, else `xs ys zs`, else `xsu ysu zsu`.
//! The numbers in `xs ys zs` and `xsu ysu zsu` are fractions of the edges of the box, which may be
//! a parallelepiped (LAMMPS' documentation of the command `dump`, and "Triclinic simulation
//! boxes"). `sim.dump#1000` denotes the step with number 1000.

use super::bytes::{Bytes, Unpacking};
use super::error::ADD_Z;
use super::number::ParseNumber;
use super::table::{
    Cell, Separator, Syntax, TableColumns, TextTable, excerpt, name_plane, names_of,
};
use super::text::{LinePlace, TextLines};
use super::wanted::WantedAttributes;
use super::{ParticleFile, ReadFault};

/// Start of a section's first line.
const ITEM: &str = "ITEM:";

/// Names of the position columns, in order of preference. The flag is true for fractions of the
/// box.
const POSITIONS: [([&str; 3], bool); 4] = [
    (["x", "y", "z"], false),
    (["xu", "yu", "zu"], false),
    (["xs", "ys", "zs"], true),
    (["xsu", "ysu", "zsu"], true),
];

/// A step of a dump.
struct DumpStep {
    number: u64,
    time: Option<f64>,
    cell: Option<Cell>,
    names: Vec<String>,
    atoms: u64,
    /// The number of rows that the step contains.
    rows: u64,
    start: usize,
    end: usize,
    lines_above: u64,
}

/// Whether a text starts like a LAMMPS dump.
pub(super) fn is_dump(head: &[u8]) -> bool {
    let head = head.strip_prefix(b"\xef\xbb\xbf").unwrap_or(head).trim_ascii_start();
    head.starts_with(ITEM.as_bytes())
}

/// Skips a step and returns its number. `None` at the end of the file.
///
/// # Errors
/// [`ReadFault::Line`] for an invalid line, and [`ReadFault::Unsupported`] for a dump that does not
/// contain atoms.
pub(super) fn skip_step(lines: &mut TextLines) -> Result<Option<u64>, ReadFault> {
    Ok(DumpStep::next(lines)?.map(|step| step.number))
}

/// Reads the step that starts at `place`.
///
/// # Errors
/// [`ReadFault::Line`] for an invalid line, an incomplete step, or columns without a position.
pub(super) fn read(
    bytes: Bytes,
    place: LinePlace,
    wanted: WantedAttributes,
    unpacking: Unpacking,
) -> Result<ParticleFile, ReadFault> {
    let view = bytes.view();
    let mut lines = TextLines::at(view, place)?;
    let step =
        DumpStep::next(&mut lines)?.ok_or_else(|| lines.fault("expected `ITEM: TIMESTEP`"))?;
    view.check()?;
    step.read(bytes, wanted, unpacking)
}

impl DumpStep {
    /// Reads the header of a step and skips its rows. `None` at the end of the file.
    fn next(lines: &mut TextLines) -> Result<Option<Self>, ReadFault> {
        let (mut number, mut atoms, mut time, mut cell) = (None, None, None, None);
        loop {
            let Some(line) = lines.line()? else {
                return match number {
                    None => Ok(None),
                    Some(step) => Err(lines.fault(format!("the file ends within step {step}"))),
                };
            };
            if line.is_empty() {
                continue;
            }
            let Some(item) = line.strip_prefix(ITEM).map(str::trim) else {
                let found = excerpt(line.as_bytes());
                return Err(
                    lines.fault(format!("expected a line that begins with {ITEM}, found {found}"))
                );
            };
            let (name, rest) = item.split_once(' ').unwrap_or((item, ""));
            match (name, item) {
                ("TIMESTEP", _) => number = Some(value(lines)?),
                ("UNITS", _) => drop(lines.line()?),
                ("TIME", _) => time = Some(value(lines)?),
                (_, "NUMBER OF ATOMS") => atoms = Some(value(lines)?),
                ("BOX", _) => cell = Some(bounds(lines, rest)?),
                ("ATOMS", _) => {
                    let (Some(number), Some(atoms)) = (number, atoms) else {
                        let what = "ATOMS must come after TIMESTEP and NUMBER OF ATOMS";
                        return Err(lines.fault(what));
                    };
                    let LinePlace { at: start, lines_above } = lines.place();
                    let rows = lines.skip(atoms)?;
                    let names = names_of(rest.as_bytes(), Separator::Blanks);
                    let end = lines.place().at;
                    return Ok(Some(Self {
                        number,
                        time,
                        cell,
                        names,
                        atoms,
                        rows,
                        start,
                        end,
                        lines_above,
                    }));
                }
                _ => {
                    let item = item.to_lowercase();
                    let what = format!("the file contains a dump of {item}, not of atoms");
                    return Err(ReadFault::Unsupported(what));
                }
            }
        }
    }

    fn read(
        self,
        bytes: Bytes,
        wanted: WantedAttributes,
        unpacking: Unpacking,
    ) -> Result<ParticleFile, ReadFault> {
        let Self { number, mut names, .. } = self;
        if self.rows < self.atoms {
            let line = self.lines_above + self.rows;
            let what = format!("step {number} ends after {} of {} atoms", self.rows, self.atoms);
            return Err(ReadFault::Line { line, what });
        }
        let column = |name: &&str| names.iter().position(|other| other == name);
        let found = POSITIONS.iter().find_map(|(axes, are_fractions)| {
            let columns: Vec<_> = axes.iter().filter_map(column).collect();
            (columns.len() == 3).then_some((columns, *are_fractions))
        });
        let shown = names.join(" ");
        let is_plane = name_plane(&names);
        let no_position = || {
            let mut what = format!(
                "no position among the columns {shown:?}; expected x y z, xu yu zu, xs ys zs or \
                 xsu ysu zsu"
            );
            if is_plane {
                what += &format!("; {ADD_Z}");
            }
            ReadFault::Line { line: self.lines_above, what }
        };
        let (columns, are_fractions) = found.ok_or_else(no_position)?;
        for (number, name) in names.iter_mut().enumerate() {
            match columns.iter().position(|&column| column == number) {
                Some(axis) => ["x", "y", "z"][axis].clone_into(name),
                // Rename a column called x, y or z that is not the position, because it would be
                // taken for the position.
                None if matches!(&**name, "x" | "y" | "z") => name.push('_'),
                None => {}
            }
        }
        let cell = match (are_fractions, self.cell) {
            (true, None) => {
                let what = format!("step {number} has scaled coordinates, but no box");
                return Err(ReadFault::Line { line: self.lines_above, what });
            }
            (are_fractions, cell) => cell.filter(|_| are_fractions),
        };
        let table = TextTable {
            rows: self.start..self.end,
            lines_above: self.lines_above,
            syntax: Syntax::BLANKS,
            columns: TableColumns::of(names).ok_or_else(no_position)?,
            count: Some(self.atoms),
            announced: None,
            cell,
        };
        let file = table.read(bytes, wanted, unpacking, "LAMMPS dump")?;
        let box_size = self.cell.and_then(|cell| cell.sizes());
        Ok(ParticleFile { time: self.time, box_size, ..file })
    }
}

/// Parses the value on the next line.
fn value<T: std::str::FromStr>(lines: &mut TextLines) -> Result<T, ReadFault> {
    let line = lines.line()?.unwrap_or_default();
    line.parse()
        .map_err(|_| lines.fault(format!("{} is not a valid number", excerpt(line.as_bytes()))))
}

/// Reads the box from the three lines after the line `BOX BOUNDS`. `words` is the rest of that
/// line.
fn bounds(lines: &mut TextLines, words: &str) -> Result<Cell, ReadFault> {
    let mut rows = Vec::new();
    for _ in 0..3 {
        let line = lines.line()?.unwrap_or_default();
        let numbers = line.split_ascii_whitespace().map(|word| f64::of(word.as_bytes()));
        let row = numbers.collect::<Option<Vec<_>>>();
        let fault =
            || lines.fault(format!("{} are not valid bounds of a box", excerpt(line.as_bytes())));
        rows.push(row.filter(|row| (2..=4).contains(&row.len())).ok_or_else(fault)?);
    }
    Ok(match (words, &rows[0][..], &rows[1][..], &rows[2][..]) {
        // A box with arbitrary edges. Each line contains an edge and a coordinate of the origin.
        (words, &[ax, ay, az, ox], &[bx, by, bz, oy], &[cx, cy, cz, oz])
            if words.contains("abc") =>
        {
            Cell { origin: [ox, oy, oz], edges: [[ax, ay, az], [bx, by, bz], [cx, cy, cz]] }
        }
        // The bounding box of a parallelepiped, with its tilt factors.
        (_, &[xlo, xhi, xy], &[ylo, yhi, xz], &[zlo, zhi, yz]) => {
            let of = |pick: fn(f64, f64) -> f64, tilts: [f64; 3]| tilts.into_iter().fold(0.0, pick);
            let (low, high) = ([xy, xz, xy + xz], [yz, yz, yz]);
            let xlo = xlo - of(f64::min, low);
            let xhi = xhi - of(f64::max, low);
            let ylo = ylo - of(f64::min, high);
            let yhi = yhi - of(f64::max, high);
            Cell {
                origin: [xlo, ylo, zlo],
                edges: [[xhi - xlo, 0.0, 0.0], [xy, yhi - ylo, 0.0], [xz, yz, zhi - zlo]],
            }
        }
        (_, &[xlo, xhi], &[ylo, yhi], &[zlo, zhi]) => Cell {
            origin: [xlo, ylo, zlo],
            edges: [[xhi - xlo, 0.0, 0.0], [0.0, yhi - ylo, 0.0], [0.0, 0.0, zhi - zlo]],
        },
        _ => return Err(lines.fault("the box bounds must be three rows of 2, 3 or 4 numbers")),
    })
}

impl Cell {
    /// The lengths of the edges, if the box is aligned to the axes. Otherwise `None`.
    pub(super) fn sizes(&self) -> Option<[f64; 3]> {
        let along = |edge: usize| {
            let others = (0..3).filter(|axis| *axis != edge);
            others.map(|axis| self.edges[edge][axis]).all(|part| part == 0.0)
        };
        (0..3).all(along).then(|| [0, 1, 2].map(|axis| self.edges[axis][axis]))
    }
}
