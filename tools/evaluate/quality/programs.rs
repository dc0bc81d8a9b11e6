//! The compared programs, which compute surfaces from particle files.

use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Instant;

use super::lines::{SIZED, Scene};
use crate::Outcome;

/// Programs with [`Takes::Few`] or [`Takes::Slow`] get at most this many particles.
const MANY: usize = 200_000;
/// Programs with [`Takes::Slow`] omit rows with more scenes than this.
const SCENES: usize = 10;

/// A program and its settings.
#[derive(Debug, Clone, PartialEq)]
pub struct Program {
    pub name: String,
    /// The default or recommended cell size, in spacings; `None` if the program chooses it.
    pub cell: Option<f64>,
    /// The documented isovalue, followed by other isovalues to try.
    pub isos: Vec<String>,
    pub takes: Takes,
    /// The command line with the variables `{in}`, `{out}`, `{cell}` (cell size in spacings),
    /// `{cubes}` (cell size in radii), `{iso}` and `{threads}`.
    command: String,
    /// The command line for particles of several sizes; `None` if the program assumes one size.
    sized: Option<String>,
}

/// The scenes that a program can mesh in a reasonable time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Takes {
    Many,
    /// Only scenes with few particles.
    Few,
    /// Only scenes with few particles, in table rows with few scenes, because every start of the
    /// program takes long.
    Slow,
}

/// A program with one of its isovalues: a column of the tables.
#[derive(Debug, Clone, PartialEq)]
pub struct Method {
    pub name: String,
    pub program: Program,
    iso: Option<String>,
    /// Whether `iso` is the documented isovalue.
    pub documented: bool,
}

/// Reads the table of programs. Each line has six fields, separated by tabs: the name; the cell
/// size; the isovalues; one of the words `many`, `few` and `slow` (see [`Takes`]); the command; and
/// the command for particles of several sizes. `-` means that there is no value.
pub fn read(path: &Path) -> Outcome<Vec<Program>> {
    fs::read_to_string(path)?.lines().map(Program::parse).collect()
}

impl Program {
    fn parse(line: &str) -> Outcome<Self> {
        let [name, cell, isos, takes, command, sized] = line.split('\t').collect::<Vec<_>>()[..]
        else {
            return Err(format!("expected six fields separated by tabs, got `{line}`").into());
        };
        let known = |text: &str| (text != "-").then(|| text.to_owned());
        Ok(Self {
            name: name.into(),
            cell: known(cell).map(|cell| cell.parse()).transpose()?,
            isos: known(isos).iter().flat_map(|isos| isos.split(' ').map(str::to_owned)).collect(),
            takes: match takes {
                "many" => Takes::Many,
                "few" => Takes::Few,
                "slow" => Takes::Slow,
                _ => return Err(format!("expected many, few or slow, got `{takes}`").into()),
            },
            command: command.into(),
            sized: known(sized),
        })
    }

    /// The program with its documented isovalue.
    pub fn documented(&self) -> Method {
        self.at(self.isos.first().cloned(), self.name.clone(), true)
    }

    /// The program with its best isovalue, `iso`.
    pub fn best(&self, iso: &str) -> Method {
        self.at(Some(iso.into()), format!("{}, best: {iso}", self.name), false)
    }

    fn at(&self, iso: Option<String>, name: String, documented: bool) -> Method {
        Method { name, program: self.clone(), iso, documented }
    }
}

impl Method {
    /// Whether the program runs with this many particles.
    pub fn takes(&self, particles: usize) -> bool {
        self.program.takes == Takes::Many || particles <= MANY
    }

    /// Whether the program runs on a row with these scenes.
    pub fn takes_all(&self, scenes: &[Scene]) -> bool {
        let starts = self.program.takes != Takes::Slow || scenes.len() <= SCENES;
        let takes_sizes = |scene: &Scene| scene.sizes.is_none() || self.program.sized.is_some();
        starts && scenes.iter().all(|scene| self.takes(scene.points.len()) && takes_sizes(scene))
    }

    /// The words of the command line. Leaves out words with a variable that has no value.
    fn words(&self, files: [&Path; 2], cell: Option<f64>, threads: usize) -> Vec<String> {
        let cell = cell.or(self.program.cell);
        let [input, output] = files.map(|file| Some(file.display().to_string()));
        let values = [
            ("{in}", input),
            ("{out}", output),
            ("{cell}", cell.map(|cell| cell.to_string())),
            ("{cubes}", cell.map(|cell| (2.0 * cell).to_string())),
            ("{iso}", self.iso.clone()),
            ("{threads}", Some(threads.to_string())),
        ];
        let filled = |word: &str| {
            values.iter().try_fold(word.to_owned(), |word, (name, value)| match value {
                Some(value) => Some(word.replace(name, value)),
                None => (!word.contains(name)).then_some(word),
            })
        };
        let Program { command, sized, .. } = &self.program;
        let is_sized = files[0].extension().is_some_and(|extension| extension == SIZED);
        let command = sized.as_ref().filter(|_| is_sized).unwrap_or(command);
        command.split_whitespace().filter_map(filled).collect()
    }

    /// Runs the program, and returns its time, in seconds. Returns `None` if the program failed or
    /// found no surface.
    pub fn run(
        &self,
        files: [&Path; 2],
        cell: Option<f64>,
        threads: usize,
    ) -> Outcome<Option<f64>> {
        let words = self.words(files, cell, threads);
        let start = Instant::now();
        let mut command = Command::new(&words[0]);
        let done = command.args(&words[1..]).stdin(Stdio::null()).output();
        let done = done.map_err(|fault| format!("{}: {fault}", words[0]))?;
        Ok(done.status.success().then(|| start.elapsed().as_secs_f64()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_with_an_unknown_variable_are_omitted() {
        let program =
            Program::parse("one\t-\t0.6 0.5\tfew\tone {in} -c={cubes} -t={iso} -o {out}\t-")
                .unwrap();
        let files = ["a", "b"].map(Path::new);
        let words = |method: &Method, cell| method.words(files, cell, 1).join(" ");
        assert_eq!(words(&program.documented(), None), "one a -t=0.6 -o b");
        assert_eq!(words(&program.best("0.5"), Some(0.25)), "one a -c=0.5 -t=0.5 -o b");
        assert!(program.documented().takes(MANY) && !program.documented().takes(MANY + 1));
        let scenes =
            |count: usize| -> Vec<Scene> { (0..count).map(|_| vec![[0.0; 3]].into()).collect() };
        assert!(program.documented().takes_all(&scenes(SCENES + 1)));
        let sized = Scene { points: vec![[0.0; 3]], sizes: Some(vec![1.0]) };
        assert!(!program.documented().takes_all(&[sized]));
        let slow = Program { takes: Takes::Slow, ..program }.documented();
        assert!(!slow.takes_all(&scenes(SCENES + 1)));
        assert!(slow.takes_all(&scenes(SCENES)));
    }
}
