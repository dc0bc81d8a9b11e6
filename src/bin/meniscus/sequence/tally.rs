//! What became of the frames: noted one by one, listed for other programs, and summed up at the end.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::time::{Duration, Instant};

use bytesize::ByteSize;
use meniscus::error::{Cause, Error};
use meniscus::io::series::{Series, SeriesFrame};
use meniscus::sequence::inputs::{FrameFile, gaps, missing_path};
use meniscus::sequence::records::Records;
use serde_json::json;

use crate::Verdict;
use crate::interrupt;
use crate::run::Notes;

use super::Setup;
use super::conversion::Conversion;
use super::one_frame::Done;
use crate::report::left_out;

/// Between two writings of what lists all frames, at the least.
const SERIES_PAUSE: Duration = Duration::from_millis(250);

/// What became of the frames so far.
pub struct Tally<'a> {
    conversion: &'a Conversion<'a>,
    series: &'a Series,
    /// All frames that can be loaded, of this run or another.
    listed: BTreeMap<u64, SeriesFrame>,
    /// Why a frame is not there.
    pub failed: BTreeMap<u64, String>,
    fatal: Option<Error>,
    pub done: usize,
    pub total: usize,
    /// Drops that were left out.
    drops: u64,
    begun: Instant,
    /// When the series was written last, or would have been.
    series_written: Instant,
    /// For people.
    pub notes: Notes,
}

impl<'a> Tally<'a> {
    pub fn new(conversion: &'a Conversion<'a>, series: &'a Series) -> Self {
        let begun = Instant::now();
        Self {
            conversion,
            series,
            listed: BTreeMap::new(),
            failed: BTreeMap::new(),
            fatal: None,
            done: 0,
            total: 0,
            drops: 0,
            begun,
            series_written: begun,
            notes: conversion.setup.notes.clone(),
        }
    }

    /// Lists what else is done already.
    pub fn list(&mut self, frames: &[FrameFile]) {
        let records = Records::read(self.conversion.store.folder());
        for frame in frames {
            if !self.lists(frame)
                && let Some(record) = self.conversion.current(&records, frame)
            {
                self.listed.insert(frame.number, record.mesh.clone());
            }
        }
    }

    /// Whether a frame is done.
    pub fn lists(&self, frame: &FrameFile) -> bool {
        self.listed.contains_key(&frame.number)
    }

    /// Notes a frame; true where it makes no sense to go on with any other.
    pub fn take(
        &mut self,
        frame: &FrameFile,
        result: Result<Done, Error>,
        bars: bool,
    ) -> Result<bool, Error> {
        let Setup { options, .. } = self.conversion.setup;
        let notes = self.notes.clone();
        self.done += 1;
        match result {
            Ok(Done { mesh, stats, seconds, dropped, warnings }) => {
                self.drops += dropped.drops;
                self.failed.remove(&frame.number);
                for warning in warnings {
                    notes.say(format!("warning: {}: {warning}", frame.path.display()));
                }
                let line = format!(
                    "{}: {} vertices, {} triangles, {} in {seconds:.2} s ({} of {})",
                    self.conversion.output(frame).display(),
                    mesh.vertices,
                    mesh.triangles,
                    ByteSize(mesh.bytes),
                    self.done,
                    self.total,
                );
                if bars {
                    notes.detail(line)
                } else {
                    notes.say(line)
                }
                self.listed.insert(frame.number, mesh);
                stats.map_or(Ok(()), |stats| options.append_stats(&stats))?;
                if self.series_written.elapsed() > SERIES_PAUSE {
                    self.write_series()?;
                }
            }
            Err(error) => {
                notes.error(format!("meniscus: {error}"));
                options.append_stats(&json!({
                    "frame": frame.number,
                    "input": frame.path,
                    "error": error.to_string(),
                }))?;
                self.failed.insert(frame.number, error.to_string());
                if matches!(error.cause(), Cause::Output | Cause::Device) {
                    self.fatal.get_or_insert(error);
                    return Ok(true);
                }
            }
        }
        Ok(false)
    }

    fn write_series(&mut self) -> Result<(), Error> {
        let listed: Vec<_> = self.listed.values().cloned().collect();
        interrupt::undisturbed(|| self.series.write(&listed))?;
        self.series_written = Instant::now();
        Ok(())
    }

    pub fn finish(mut self, frames: &[FrameFile]) -> Result<Verdict, Error> {
        let Setup { options, notes, inputs, .. } = self.conversion.setup;
        // Other jobs may have done frames meanwhile, and the last of them lists all.
        let alone = self.conversion.store.locked();
        self.list(&inputs.list()?);
        let log = &self.conversion.store.log;
        let (listed, merged) = std::thread::scope(|scope| {
            let merging = scope.spawn(|| interrupt::undisturbed(|| log.merge()));
            (self.write_series(), merging.join())
        });
        listed?;
        merged.unwrap_or_else(|panic| std::panic::resume_unwind(panic))?;
        drop(alone);
        let made = self.done - self.failed.len().min(self.done);
        let missing = gaps(frames);
        let gone: Vec<u64> = missing.numbers().filter(|&number| options.sequence.wants(number)).collect();
        if missing.sparse && !gone.is_empty() {
            notes.say(format!("{}: there are no frames {missing}", inputs.describe()));
        } else {
            for number in gone {
                let path = missing_path(frames, number);
                self.failed.insert(number, format!("{}: missing", path.display()));
            }
        }
        notes.say(format!(
            "{}: {made} frames in {:.2} s",
            self.conversion.setup.naming.folder().display(),
            self.begun.elapsed().as_secs_f64()
        ));
        if let Some(particles) = self.conversion.setup.reduction.smallest_drop {
            notes.say(left_out(self.drops, particles));
        }
        if !self.failed.is_empty() {
            let mut list = format!("meniscus: {} frames failed:", self.failed.len());
            for (number, cause) in &self.failed {
                let _ = write!(list, "\n  frame {number}: {cause}");
            }
            notes.error(list);
        }
        match self.fatal {
            Some(error) => Err(error),
            None if self.failed.is_empty() => Ok(Verdict::Good),
            None => Ok(Verdict::Bad),
        }
    }
}
