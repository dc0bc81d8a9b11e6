//! Counts the particles that are read, and ends reads early after a cancel.

use std::ops::Range;

use crate::system::control::{Control, Meter, Stage};

use super::{AttributeInfo, Label, Particles, RereadError};

/// Counts the particles that are read. After a cancel, positions are NaN instead of being read, so
/// every pass over the particles ends soon.
#[derive(Debug)]
pub struct MeteredParticles<'a> {
    particles: &'a dyn Particles,
    control: &'a Control,
    meter: Meter<'a>,
}

impl<'a> MeteredParticles<'a> {
    /// Counts the particles that `stage` reads. The stage must read each particle once, unless
    /// [`readings`](Self::readings) sets another number.
    pub fn new(particles: &'a dyn Particles, control: &'a Control, stage: Stage) -> Self {
        Self { particles, control, meter: control.meter(stage, particles.len()) }
    }

    /// Sets how many times the stage reads the particles.
    #[must_use]
    pub fn readings(self, readings: usize) -> Self {
        Self { meter: self.meter.times(readings), ..self }
    }

    /// Restarts the count, for the part of `stage` from its start to the fraction `to`.
    pub fn begin(&mut self, stage: Stage, to: f64) {
        self.meter = self.control.meter(stage, self.particles.len()).between(0.0, to);
    }
}

impl Particles for MeteredParticles<'_> {
    fn len(&self) -> usize {
        self.particles.len()
    }

    fn positions(&self, first: usize, out: &mut [[f64; 3]]) {
        if !self.meter.goes_on() {
            return out.fill([f64::NAN; 3]);
        }
        self.particles.positions(first, out);
        self.meter.add(out.len());
    }

    fn check(&self) -> Result<(), RereadError> {
        self.particles.check()
    }

    fn goes_on(&self) -> bool {
        self.meter.goes_on() && self.particles.goes_on()
    }

    fn resident_bytes(&self) -> u64 {
        self.particles.resident_bytes()
    }

    fn release(&self, range: Range<usize>) {
        self.particles.release(range);
    }

    fn attributes(&self) -> &[AttributeInfo] {
        self.particles.attributes()
    }

    fn attribute(&self, index: usize, first: usize, out: &mut [f32]) {
        if !self.meter.goes_on() {
            return out.fill(f32::NAN);
        }
        self.particles.attribute(index, first, out);
    }

    fn labels(&self) -> &[Label] {
        self.particles.labels()
    }

    fn label(&self, index: usize, first: usize, out: &mut [u32]) {
        self.particles.label(index, first, out);
    }

    fn component(&self, of: (usize, usize), first: usize, out: &mut [f64]) {
        if !self.meter.goes_on() {
            return out.fill(f64::NAN);
        }
        self.particles.component(of, first, out);
    }

    fn integers(&self, index: usize, first: usize, out: &mut [i64]) {
        if !self.meter.goes_on() {
            return out.fill(0);
        }
        self.particles.integers(index, first, out);
    }
}
