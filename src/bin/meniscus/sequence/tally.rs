//! What became of the frames: noted one by one, listed for other programs, and summed up at the end.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use bytesize::ByteSize;
use meniscus::error::{Cause, Error};
use meniscus::io::series::{Series, SeriesFrame};
use meniscus::simulation::inputs::{FrameFile, gaps, missing_path};
use meniscus::simulation::records::Records;
use rayon::prelude::*;
use serde_json::json;

use crate::advice::told;
use crate::interrupt;
use crate::outcome::Verdict;
use crate::run::Notes;

use super::one_frame::Done;
use super::setup::Setup;
use super::shared::Conversion;
use crate::report::{LeftOut, dropped};

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
    left_out: LeftOut,
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
            left_out: LeftOut::default(),
            begun,
            series_written: begun,
            notes: conversion.setup.notes.clone(),
        }
    }

    /// Lists what else is done already. Those whose bytes are looked at are done if these are as they were written.
    pub fn list(&mut self, frames: &[FrameFile], is_looked_at: impl Fn(&FrameFile) -> bool + Sync) {
        let records = Records::read(self.conversion.store.folder());
        let Self { conversion, listed, failed, .. } = self;
        let done = |frame: &FrameFile| {
            let number = frame.number;
            let is_open = !listed.contains_key(&number) && !failed.contains_key(&number);
            let record = conversion.current(&records, frame).filter(|_| is_open)?;
            let is_done = !is_looked_at(frame) || record.is_whole(&conversion.output(frame));
            is_done.then(|| (number, record.mesh.clone()))
        };
        let done: Vec<_> = frames.par_iter().filter_map(done).collect();
        listed.extend(done);
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
            Ok(Done { mesh, stats, seconds, left_out, warnings }) => {
                self.left_out.add(&left_out);
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
                notes.error(format!("meniscus: {}", told(&error)));
                options.append_stats(&json!({
                    "frame": frame.number,
                    "input": frame.path,
                    "error": told(&error),
                }))?;
                self.failed.insert(frame.number, told(&error));
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
        self.list(&self.conversion.setup.all_frames()?, |_| false);
        let log = &self.conversion.store.log;
        let (listed, merged) = std::thread::scope(|scope| {
            let merging = scope.spawn(|| interrupt::undisturbed(|| log.merge()));
            (self.write_series(), merging.join())
        });
        listed?;
        merged.unwrap_or_else(|panic| std::panic::resume_unwind(panic))?;
        drop(alone);
        let made = self.done - self.failed.len().min(self.done);
        let (first, last) = options.sequence.wanted();
        let mut missing = gaps(frames).within(first, last);
        if missing.sparse && missing.count() > 0 {
            notes.say(format!("{}: there are no frames {missing}", inputs.describe()));
            missing.ranges.clear();
        }
        notes.say(format!(
            "{}: {made} frames in {:.2} s",
            self.conversion.setup.naming.folder().display(),
            self.begun.elapsed().as_secs_f64()
        ));
        if let Some(particles) = self.conversion.setup.reduction.smallest_drop {
            notes.say(dropped(self.left_out.drops, particles));
        }
        self.left_out.say(self.conversion.setup.request.field, notes);
        let failed = self.failed.len() as u64 + missing.count();
        if failed > 0 {
            let one = |(number, cause): (&u64, &String)| (*number, format!("frame {number}: {cause}"));
            let gap = |&(first, last): &(u64, u64)| {
                let [from, to] =
                    [first, last].map(|number| missing_path(frames, number).display().to_string());
                (
                    first,
                    if first == last {
                        format!("frame {first}: {from}: missing")
                    } else {
                        format!("frames {first} to {last}: {from} to {to}: missing")
                    },
                )
            };
            let mut lines: Vec<(u64, String)> =
                self.failed.iter().map(one).chain(missing.ranges.iter().map(gap)).collect();
            lines.sort();
            let mut list = format!("meniscus: {failed} frames failed:");
            lines.iter().for_each(|(_, line)| list += &format!("\n  {line}"));
            notes.error(list);
        }
        match self.fatal {
            Some(error) => Err(error),
            None if failed == 0 => Ok(Verdict::Good),
            None => Ok(Verdict::Bad),
        }
    }
}
