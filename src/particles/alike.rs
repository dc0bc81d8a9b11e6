//! Converts the attributes of a frame to the types that all frames of a simulation share.

use std::ops::Range;

use rayon::prelude::*;

use super::kind::{KindFault, SettledKind, colour_kind, whole_extremes};
use super::{AttributeInfo, AttributeKind, Label, Particles, RereadError, carried_infos, chunks};

/// Particles whose attributes have the types that all frames of a simulation share. Programs that
/// play the frames expect one type for each attribute.
///
/// Integers become floating-point numbers, or floating-point numbers become integers if all values
/// are whole. A colour loses its alpha, or gets an alpha that means opaque.
#[derive(Debug)]
pub struct AlikeParticles<'a> {
    particles: &'a dyn Particles,
    attributes: Vec<AttributeInfo>,
    /// For each attribute, the alpha of an opaque colour; 0 if the attribute is not a colour.
    opaque: Vec<f32>,
    changed_alpha: Vec<AlphaChange>,
}

/// A colour that has alpha in this frame but not in the other frames, or the reverse.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AlphaChange {
    /// The attribute's name on the mesh.
    pub attribute: String,
    /// Number of components in this frame.
    pub own: usize,
    /// Number of components in the other frames.
    pub shared: usize,
}

impl<'a> AlikeParticles<'a> {
    /// Converts the attributes with the indices in `carried` to the types in `known`. Reads the
    /// values of the attributes that it converts. An attribute that `known` does not contain keeps
    /// its own type.
    ///
    /// # Errors
    /// [`KindFault`] for values that the shared type cannot represent.
    pub fn of(
        particles: &'a dyn Particles,
        carried: &[usize],
        known: &[SettledKind],
    ) -> Result<Self, KindFault> {
        let attributes = particles.attributes().to_vec();
        let opaque = vec![0.0; attributes.len()];
        let mut all = Self { particles, attributes, opaque, changed_alpha: Vec::new() };
        let infos = carried_infos(particles.attributes(), carried);
        for (info, &index) in infos.into_iter().zip(carried) {
            let known = known.iter().find(|known| known.stored.name == info.name);
            if let Some(known) = known.filter(|known| known.stored != info) {
                all.convert(index, info, known)?;
            }
        }
        Ok(all)
    }

    /// The colours that lose or get an alpha.
    pub fn changed_alpha(&self) -> &[AlphaChange] {
        &self.changed_alpha
    }

    fn convert(
        &mut self,
        index: usize,
        info: AttributeInfo,
        known: &SettledKind,
    ) -> Result<(), KindFault> {
        let particles = self.particles;
        let SettledKind { ref stored, kind, .. } = *known;
        let colour = colour_kind(particles, index).filter(|_| kind.is_colour());
        let is_same_size = info.components == stored.components;
        let converted = &mut self.attributes[index];
        if particles.is_empty() {
            (converted.components, converted.kind) = (stored.components, stored.kind);
        } else if let Some(colour) = colour {
            // A mesh stores colours of all scales as the same type.
            converted.components = stored.components;
            self.opaque[index] = colour.opaque();
            if !is_same_size {
                let (own, shared) = (info.components, stored.components);
                self.changed_alpha.push(AlphaChange { attribute: info.name, own, shared });
            }
        } else if is_same_size && kind.is_whole() {
            let [low, high] = match info.kind.is_whole() {
                true => whole_extremes(particles, index),
                false => extremes_of_floats(particles, index)
                    .map_err(|value| KindFault::Fraction { name: info.name.clone(), value })?,
            };
            kind.check_whole(&info.name, [low, high])?;
            converted.kind = stored.kind;
        } else if is_same_size && kind == AttributeKind::Number {
            converted.kind = stored.kind;
        } else {
            let of_others = AttributeInfo { kind, ..stored.clone() };
            let [own, shared] = [&info, &of_others].map(AttributeInfo::type_text);
            return Err(KindFault::Type { name: info.name, own, shared });
        }
        Ok(())
    }

    /// The number of components that the frame stores for an attribute. `None` if the shared type
    /// has the same number.
    fn other_components(&self, index: usize) -> Option<usize> {
        let own = self.particles.attributes()[index].components;
        (own != self.attributes[index].components).then_some(own)
    }
}

/// The minimum and maximum over 0 and all values of an attribute of floating-point numbers. The
/// error is a value that is not a whole number.
fn extremes_of_floats(particles: &dyn Particles, index: usize) -> Result<[i64; 2], f64> {
    let components = particles.attributes()[index].components;
    let of_chunk = |range: Range<usize>| {
        let mut values = vec![0.0; range.len()];
        let mut extremes = [0_i64; 2];
        for component in 0..components {
            particles.component((index, component), range.start, &mut values);
            if let Some(&fraction) = values.iter().find(|value| value.fract() != 0.0) {
                return Err(fraction);
            }
            let [low, high] = &mut extremes;
            values
                .iter()
                .for_each(|&x| (*low, *high) = ((*low).min(x as i64), (*high).max(x as i64)));
        }
        Ok(extremes)
    };
    let of_both = |[a, b]: [i64; 2], [c, d]: [i64; 2]| Ok([a.min(c), b.max(d)]);
    chunks(particles, of_chunk).try_reduce(|| [0; 2], of_both)
}

impl Particles for AlikeParticles<'_> {
    fn len(&self) -> usize {
        self.particles.len()
    }

    fn positions(&self, first: usize, out: &mut [[f64; 3]]) {
        self.particles.positions(first, out);
    }

    fn check(&self) -> Result<(), RereadError> {
        self.particles.check()
    }

    fn goes_on(&self) -> bool {
        self.particles.goes_on()
    }

    fn resident_bytes(&self) -> u64 {
        self.particles.resident_bytes()
    }

    fn release(&self, range: Range<usize>) {
        self.particles.release(range);
    }

    fn attributes(&self) -> &[AttributeInfo] {
        &self.attributes
    }

    fn attribute(&self, index: usize, first: usize, out: &mut [f32]) {
        let Some(own) = self.other_components(index) else {
            return self.particles.attribute(index, first, out);
        };
        let shared = self.attributes[index].components;
        let mut values = vec![0.0; out.len() / shared * own];
        self.particles.attribute(index, first, &mut values);
        let both = own.min(shared);
        for (out, values) in out.chunks_mut(shared).zip(values.chunks(own)) {
            out[..both].copy_from_slice(&values[..both]);
            out[both..].fill(self.opaque[index]);
        }
    }

    fn labels(&self) -> &[Label] {
        self.particles.labels()
    }

    fn label(&self, index: usize, first: usize, out: &mut [u32]) {
        self.particles.label(index, first, out);
    }

    fn component(&self, (index, component): (usize, usize), first: usize, out: &mut [f64]) {
        if component < self.particles.attributes()[index].components {
            self.particles.component((index, component), first, out);
        } else {
            out.fill(self.opaque[index].into());
        }
    }

    fn integers(&self, index: usize, first: usize, out: &mut [i64]) {
        let stored = &self.particles.attributes()[index];
        if stored.kind.is_whole() {
            return self.particles.integers(index, first, out);
        }
        // Read f64, because f32 cannot represent large integers exactly.
        let components = stored.components;
        let mut values = vec![0.0; out.len() / components];
        for component in 0..components {
            self.particles.component((index, component), first, &mut values);
            let out = out.iter_mut().skip(component).step_by(components);
            out.zip(&values).for_each(|(out, &value)| *out = value as i64);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::kind::{determine, settled_for_all};
    use super::*;

    /// Particles at the origin with one attribute.
    struct Valued {
        info: AttributeInfo,
        values: Vec<f64>,
    }

    impl Valued {
        fn new(name: &str, kind: AttributeKind, components: usize, values: &[f64]) -> Self {
            let info = AttributeInfo { name: name.into(), components, kind };
            Self { info, values: values.to_vec() }
        }

        fn kinds(&self) -> Vec<SettledKind> {
            settled_for_all(self, &[0])
        }

        /// The particles, with the attribute type of `other`.
        fn like(&self, other: &Self) -> Result<AlikeParticles<'_>, KindFault> {
            AlikeParticles::of(self, &[0], &other.kinds())
        }
    }

    impl Particles for Valued {
        fn len(&self) -> usize {
            self.values.len() / self.info.components
        }

        fn positions(&self, _: usize, out: &mut [[f64; 3]]) {
            out.fill([0.0; 3]);
        }

        fn attributes(&self) -> &[AttributeInfo] {
            std::slice::from_ref(&self.info)
        }

        fn attribute(&self, _: usize, first: usize, out: &mut [f32]) {
            let values = self.values[first * self.info.components..].iter();
            out.iter_mut().zip(values).for_each(|(out, &value)| *out = value as f32);
        }

        fn component(&self, (_, component): (usize, usize), first: usize, out: &mut [f64]) {
            let n = self.info.components;
            out.iter_mut().zip(first..).for_each(|(out, i)| *out = self.values[i * n + component]);
        }
    }

    #[test]
    fn whole_floats_become_exact_integers_and_fractions_are_an_error() {
        let ids = Valued::new("id", AttributeKind::Signed, 1, &[1.0, 2.0]);
        let float = |values| Valued::new("id", AttributeKind::Number, 1, values);
        let exact = float(&[16_777_217.0, -3.0]);
        let alike = exact.like(&ids).unwrap();
        assert_eq!(alike.attributes(), ids.attributes());
        let mut read = [0; 2];
        alike.integers(0, 0, &mut read);
        assert_eq!(read, [16_777_217, -3]);
        let fault = |values| float(values).like(&ids).map(drop).unwrap_err();
        assert!(matches!(fault(&[1.0, 0.5]), KindFault::Fraction { value: 0.5, .. }));
        assert!(matches!(fault(&[f64::NAN]), KindFault::Fraction { .. }));
        assert!(matches!(fault(&[1e10]), KindFault::TooWide { value: 10_000_000_000, .. }));
        assert_eq!(ids.like(&exact).unwrap().attributes(), exact.attributes());
    }

    #[test]
    fn constant_integers_become_floats_if_another_frame_has_fractions() {
        let fractions = Valued::new("temp", AttributeKind::Number, 1, &[0.5, 1.5]);
        for (values, expected) in
            [([0.0, 0.0], AttributeKind::Number), ([0.0, 1.0], AttributeKind::Signed)]
        {
            let mut kinds = Valued::new("temp", AttributeKind::Signed, 1, &values).kinds();
            determine(&mut kinds, fractions.kinds());
            assert_eq!(kinds[0].kind, expected, "{values:?}");
        }
    }

    #[test]
    fn a_colour_loses_its_alpha_or_becomes_opaque() {
        let rgb = Valued::new("Cd", AttributeKind::Colour, 3, &[0.1, 0.2, 0.3, 0.4, 0.5, 0.6]);
        let rgba = Valued::new("Cd", AttributeKind::ByteColour, 4, &[1.0, 2.0, 3.0, 4.0]);
        let read = |alike: &AlikeParticles<'_>| {
            let mut values = vec![0.0; alike.len() * alike.attributes()[0].components];
            alike.attribute(0, 0, &mut values);
            values
        };
        let without = rgba.like(&rgb).unwrap();
        assert_eq!(read(&without), [1.0, 2.0, 3.0]);
        let change = AlphaChange { attribute: "Cd".into(), own: 4, shared: 3 };
        assert_eq!(without.changed_alpha(), [change]);
        let with = rgb.like(&rgba).unwrap();
        assert_eq!(read(&with), [0.1, 0.2, 0.3, 1.0, 0.4, 0.5, 0.6, 1.0]);
        let bytes = Valued::new("Cd", AttributeKind::ByteColour, 3, &[1.0, 2.0, 3.0]);
        assert_eq!(read(&bytes.like(&rgba).unwrap()), [1.0, 2.0, 3.0, 255.0]);
    }

    #[test]
    fn another_number_of_components_is_an_error_unless_there_are_no_particles() {
        let one = Valued::new("temp", AttributeKind::Number, 1, &[0.5]);
        let three = |values| Valued::new("temp", AttributeKind::Number, 3, values);
        let fault = three(&[0.5, 1.5, 2.5]).like(&one).map(drop).unwrap_err();
        let KindFault::Type { name, own, shared } = fault else { panic!("{fault}") };
        assert_eq!(name, "temp");
        assert_eq!([own, shared], ["3 floating-point numbers", "one floating-point number"]);
        assert_eq!(three(&[]).like(&one).unwrap().attributes(), one.attributes());
    }
}
