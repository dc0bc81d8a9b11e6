//! Tables with a column for each method: sets of particles, the meshes that each method makes from
//! them, and their measurement.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

use meniscus::internals::io::output::read_mesh;
use meniscus::internals::surface::mesh::Mesh;
use rayon::prelude::*;
use tempfile::TempDir;

use super::programs::Method;
use crate::Outcome;
use crate::tables::Table;

/// Positions of particles.
pub type Points = Vec<[f64; 3]>;

type Reading = Box<dyn Fn(&[Mesh]) -> Outcome<Vec<String>> + Send + Sync>;

/// Scenes whose surfaces are measured together, for one row of a table or more.
pub struct Line {
    pub rows: Vec<String>,
    /// In spacings; none for the default of each method.
    pub cell: Option<f64>,
    pub scenes: Vec<Points>,
    pub lost: Lost,
    /// Returns a text for each row from the meshes of all scenes.
    pub read: Reading,
}

/// What is lost if a method finds no surface of a scene.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Lost {
    /// The rows say `none`.
    Row,
    /// The mesh of the scene is empty. The rows say `none` if all are.
    Scene,
}

/// The methods, and a folder for intermediate files.
pub struct Board {
    pub methods: Vec<Method>,
    folder: TempDir,
    files: AtomicUsize,
}

impl Board {
    pub fn new(methods: Vec<Method>) -> Outcome<Self> {
        Ok(Self { methods, folder: TempDir::new()?, files: AtomicUsize::new(0) })
    }

    /// A new file name.
    pub fn file(&self, extension: &str) -> PathBuf {
        let number = self.files.fetch_add(1, Ordering::Relaxed);
        self.folder.path().join(format!("{number}.{extension}"))
    }

    /// None if the method finds no surface.
    pub fn mesh(
        &self,
        method: &Method,
        particles: &Path,
        cell: Option<f64>,
    ) -> Outcome<Option<Mesh>> {
        let output = self.file("ply");
        let Some(_) = method.run([particles, &output], cell, 1)? else { return Ok(None) };
        let mesh = read_mesh(&output)?;
        std::fs::remove_file(&output)?;
        Ok((!mesh.triangles.is_empty()).then_some(mesh))
    }

    /// Prints a table of all methods for `lines`.
    pub fn table(&self, heading: &str, lines: Vec<Line>) -> Outcome<()> {
        let start = Instant::now();
        let inputs: Vec<Vec<PathBuf>> =
            lines.iter().map(|line| self.inputs(line)).collect::<Outcome<_>>()?;
        let jobs: Vec<(usize, usize)> = (0..lines.len())
            .flat_map(|line| (0..self.methods.len()).map(move |method| (line, method)))
            .collect();
        let texts: Vec<Vec<String>> = jobs
            .par_iter()
            .with_max_len(1)
            .map(|&(line, method)| self.texts(&lines[line], &inputs[line], &self.methods[method]))
            .collect::<Outcome<_>>()?;

        let head: Vec<&str> =
            [""].into_iter().chain(self.methods.iter().map(|method| &*method.name)).collect();
        let mut table = Table::new(&head);
        for (line, texts) in lines.iter().zip(texts.chunks(self.methods.len())) {
            for (row, name) in line.rows.iter().enumerate() {
                table.row(
                    [name.clone()].into_iter().chain(texts.iter().map(|texts| texts[row].clone())),
                );
            }
        }
        table.show(heading);
        eprintln!("{:.0} s: {heading}", start.elapsed().as_secs_f64());
        Ok(())
    }

    fn inputs(&self, line: &Line) -> Outcome<Vec<PathBuf>> {
        line.scenes.iter().map(|scene| self.input(scene)).collect()
    }

    /// Writes raw f32 triples to a new file.
    pub fn input(&self, particles: &[[f64; 3]]) -> Outcome<PathBuf> {
        let path = self.file("xyz");
        let mut out = BufWriter::new(File::create(&path)?);
        for coordinate in particles.as_flattened() {
            out.write_all(&(*coordinate as f32).to_le_bytes())?;
        }
        out.flush()?;
        Ok(path)
    }

    fn texts(&self, line: &Line, inputs: &[PathBuf], method: &Method) -> Outcome<Vec<String>> {
        let all = |text: &str| Ok(vec![text.to_owned(); line.rows.len()]);
        if !method.takes_all(line.scenes.iter().map(Vec::len)) {
            return all("");
        }
        let meshes = inputs.iter().map(|input| self.mesh(method, input, line.cell));
        let meshes = meshes.collect::<Outcome<Vec<Option<Mesh>>>>()?;
        let needed = match line.lost {
            Lost::Row => meshes.len(),
            Lost::Scene => 1,
        };
        if meshes.iter().flatten().count() < needed {
            return all("none");
        }
        let meshes: Vec<Mesh> = meshes.into_iter().map(Option::unwrap_or_default).collect();
        (line.read)(&meshes)
    }
}

/// For the name of a row.
pub fn cell_name(cell: Option<f64>) -> String {
    cell.map_or("own cells".into(), |cell| format!("cells {cell}"))
}
