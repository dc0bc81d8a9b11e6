//! Particles in the caller's memory, read where they are.

use std::ffi::c_char;
use std::slice::from_raw_parts;

use meniscus::Particles;
use meniscus::files::{AttributeInfo, AttributeKind, velocity_attribute};

use crate::sized::{Growing, read};
use crate::status::{Failure, Outcome};
use crate::text::optional;

/// The type of numbers in the caller's memory. Positions are F32 or F64.
#[repr(i32)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MeniscusType {
    /// float, 4 bytes.
    F32 = 0,
    /// double, 8 bytes.
    F64 = 1,
    /// int32_t, 4 bytes: for attributes.
    I32 = 2,
    /// uint32_t, 4 bytes: for attributes.
    U32 = 3,
}

impl MeniscusType {
    /// The type that a number of a structure stands for: callers may write any number there.
    fn of(number: i32, what: &str) -> Outcome<Self> {
        match number {
            0 => Ok(Self::F32),
            1 => Ok(Self::F64),
            2 => Ok(Self::I32),
            3 => Ok(Self::U32),
            _ => Err(Failure::request(format!("{what} is {number}, which is no MeniscusType"))),
        }
    }
}

/// A value that every particle carries: one number, or several. To be filled with zeros but for
/// what is said.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct MeniscusAttribute {
    /// sizeof(MeniscusAttribute).
    pub size: usize,
    /// The name, by which it is asked for and the vertices have it. "velocity" of three components,
    /// or another usual name of it such as "v" or "vel", is carried to the vertices where nothing
    /// else is asked for.
    pub name: *const c_char,
    /// The first number of the first particle; need not be aligned.
    pub values: *const std::ffi::c_void,
    /// Bytes from a particle's first number to the next particle's; 0 where values lie side by
    /// side. May be negative.
    pub stride: isize,
    /// Bytes from one number of a particle to its next; 0 where they lie side by side. May be
    /// negative.
    pub component_stride: isize,
    /// Numbers per particle, from 1 to 65536.
    pub components: u32,
    /// The type of the numbers, one of MeniscusType. F32 and F64 are carried as float: a double that
    /// is not finite as such counts as none. I32 and U32, such as identifiers, are carried as they
    /// are: a vertex has those of the particle nearest to it, for meniscus_mesh_attribute_whole.
    pub number: i32,
}

/// Particles in memory. To be filled with zeros but for what is said.
///
/// They are read where they are, several times and by several threads, while the call lasts that is
/// given them, and must stay as they are meanwhile. Positions are in any unit, the same for all
/// lengths.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct MeniscusParticles {
    /// sizeof(MeniscusParticles).
    pub size: usize,
    /// The number of particles.
    pub count: u64,
    /// The first particle's x; need not be aligned.
    pub positions: *const std::ffi::c_void,
    /// Bytes from a particle's x to the next particle's; 0 where positions lie side by side. May be
    /// negative.
    pub stride: isize,
    /// Bytes from x to y, and from y to z; 0 where they lie side by side. May be negative.
    pub component_stride: isize,
    /// Further values of the particles, side by side; NULL for none.
    pub attributes: *const MeniscusAttribute,
    /// How many attributes there are.
    pub attribute_count: usize,
    /// The type of the coordinates, MENISCUS_TYPE_F32 or MENISCUS_TYPE_F64.
    pub number: i32,
    /// Must be 0.
    pub reserved: i32,
}

// SAFETY: numbers and pointers.
unsafe impl Growing for MeniscusAttribute {
    const NAME: &str = "MeniscusAttribute";
}

// SAFETY: numbers and pointers.
unsafe impl Growing for MeniscusParticles {
    const NAME: &str = "MeniscusParticles";
}

/// More components than any simulator has.
const MOST_COMPONENTS: u32 = 1 << 16;

/// Attributes are numbered by few: more are a slip.
const MOST_ATTRIBUTES: usize = 1 << 16;

/// Numbers of particles at equal distances.
#[derive(Debug, Clone, Copy)]
struct Numbers {
    at: *const u8,
    number: MeniscusType,
    stride: isize,
    component_stride: isize,
    components: usize,
}

impl Numbers {
    /// Refuses what cannot be in memory: all numbers of `count` particles must have addresses.
    fn refuse_unaddressable(&self, count: usize, what: &str) -> Outcome {
        if count == 0 {
            return Ok(());
        }
        if self.at.is_null() {
            return Err(Failure::request(format!(
                "{what} is NULL, and {count} particles are said to be there"
            )));
        }
        let far =
            |steps: usize, stride: isize| isize::try_from(steps - 1).ok()?.checked_mul(stride);
        let reach = || -> Option<()> {
            let ends = [far(count, self.stride)?, far(self.components, self.component_stride)?];
            let lowest: isize =
                ends.iter().map(|end| (*end).min(0)).try_fold(0_isize, isize::checked_add)?;
            let highest: isize = ends
                .iter()
                .map(|end| (*end).max(0))
                .try_fold(self.number.bytes(), isize::checked_add)?;
            self.at.addr().checked_add_signed(lowest)?;
            self.at.addr().checked_add_signed(highest)?;
            highest.checked_sub(lowest)?;
            Some(())
        };
        let strides = [self.stride, self.component_stride];
        reach().ok_or_else(|| {
            Failure::request(format!(
                "{what}: {count} particles, strides {strides:?}: more than memory holds"
            ))
        })
    }

    /// Whether numbers lie side by side, where their type may lie.
    fn is_packed<T>(&self) -> bool {
        let number = self.number.bytes();
        self.component_stride == number
            && self.stride == number * self.components as isize
            && self.at.cast::<T>().is_aligned()
    }

    /// Number `component` of a particle.
    ///
    /// # Safety
    /// There is such a particle, and its memory is valid.
    unsafe fn get(&self, particle: usize, component: usize) -> f64 {
        let offset = particle as isize * self.stride + component as isize * self.component_stride;
        // SAFETY: within what the caller has said is there; no offset overflows, as was looked at.
        unsafe {
            let at = self.at.offset(offset);
            match self.number {
                MeniscusType::F32 => f64::from(at.cast::<f32>().read_unaligned()),
                MeniscusType::F64 => at.cast::<f64>().read_unaligned(),
                MeniscusType::I32 => at.cast::<i32>().read_unaligned().into(),
                MeniscusType::U32 => at.cast::<u32>().read_unaligned().into(),
            }
        }
    }
}

impl MeniscusType {
    fn bytes(self) -> isize {
        match self {
            Self::F32 | Self::I32 | Self::U32 => 4,
            Self::F64 => 8,
        }
    }

    fn is_whole(self) -> bool {
        matches!(self, Self::I32 | Self::U32)
    }

    /// The meaning of an attribute of these numbers: as of one in a file that stores such.
    fn meaning(self, info: &AttributeInfo) -> AttributeKind {
        match self {
            Self::F32 | Self::F64 => info.kind,
            _ if info.kind.is_colour() => AttributeKind::Number,
            _ if velocity_attribute(std::slice::from_ref(info)).is_some() => AttributeKind::Number,
            Self::I32 => AttributeKind::Signed,
            Self::U32 => AttributeKind::Unsigned,
        }
    }
}

/// Particles of the caller's, of whom everything that can be checked is.
#[derive(Debug)]
pub struct Borrowed {
    count: usize,
    positions: Numbers,
    attributes: Vec<AttributeInfo>,
    values: Vec<Numbers>,
}

// SAFETY: the caller has agreed to be read by several threads.
unsafe impl Sync for Borrowed {}
// SAFETY: as above.
unsafe impl Send for Borrowed {}

impl Borrowed {
    /// Takes what a caller says of its particles.
    ///
    /// # Safety
    /// `at` is NULL or points to a structure of the size that it says, and so do its attributes;
    /// what these point to is there and stays as it is as long as this lives.
    pub unsafe fn new(at: *const MeniscusParticles) -> Outcome<Self> {
        // SAFETY: as for this function.
        let said = unsafe { read(at, "particles") }?;
        let number = MeniscusType::of(said.number, "particles.number")?;
        if number.is_whole() {
            return Err(Failure::request(format!(
                "particles.number is {}: coordinates are MENISCUS_TYPE_F32 or MENISCUS_TYPE_F64",
                said.number
            )));
        }
        if said.reserved != 0 {
            return Err(Failure::request(format!(
                "particles.reserved is {}, and must be 0",
                said.reserved
            )));
        }
        let Ok(count) = usize::try_from(said.count) else {
            return Err(Failure::request(format!(
                "particles.count is {}: too many for this machine",
                said.count
            )));
        };
        let positions = Numbers {
            at: said.positions.cast(),
            number,
            stride: said.stride,
            component_stride: said.component_stride,
            components: 3,
        }
        .with_strides();
        positions.refuse_unaddressable(count, "particles.positions")?;
        let mut particles = Self { count, positions, attributes: Vec::new(), values: Vec::new() };
        // SAFETY: as for this function.
        unsafe { particles.take(said.attributes, said.attribute_count) }?;
        Ok(particles)
    }

    /// Takes attributes; an older caller's structures are smaller, and lie as far apart as they
    /// say.
    ///
    /// # Safety
    /// As for [`new`](Self::new).
    unsafe fn take(&mut self, at: *const MeniscusAttribute, count: usize) -> Outcome {
        if count == 0 {
            return Ok(());
        }
        if at.is_null() {
            return Err(Failure::request(format!(
                "particles.attributes is NULL, and {count} are said to be there"
            )));
        }
        if count > MOST_ATTRIBUTES {
            return Err(Failure::request(format!(
                "particles.attribute_count is {count}: at most {MOST_ATTRIBUTES}"
            )));
        }
        let mut size = 0;
        for index in 0..count {
            let what = format!("particles.attributes[{index}]");
            // SAFETY: as for this function; all before were of this size.
            let said = unsafe { read(at.byte_add(index * size), &what) }?;
            if index > 0 && said.size != size {
                let sizes = format!("its size is {}, and that of those before {size}", said.size);
                return Err(Failure::request(format!("{what}: {sizes}")));
            }
            size = said.size;
            // SAFETY: as for this function.
            let name = unsafe { optional(said.name, &format!("{what}.name")) }?;
            let name = name.filter(|name| !name.is_empty());
            let name =
                name.ok_or_else(|| Failure::request(format!("{what}.name is NULL, or empty")))?;
            if self.attributes.iter().any(|info| info.name == name) {
                return Err(Failure::request(format!(
                    "{what}.name: another attribute is called {name:?}"
                )));
            }
            if !(1..=MOST_COMPONENTS).contains(&said.components) {
                let range = format!("is {}, and must be 1 to {MOST_COMPONENTS}", said.components);
                return Err(Failure::request(format!("{what}.components {range}")));
            }
            let numbers = Numbers {
                at: said.values.cast(),
                number: MeniscusType::of(said.number, &format!("{what}.number"))?,
                stride: said.stride,
                component_stride: said.component_stride,
                components: said.components as usize,
            }
            .with_strides();
            numbers.refuse_unaddressable(self.count, &format!("{what}.values"))?;
            let info = AttributeInfo::new(name, numbers.components);
            let kind = numbers.number.meaning(&info);
            self.attributes.push(AttributeInfo { kind, ..info });
            self.values.push(numbers);
        }
        Ok(())
    }

    /// Bytes of the positions, by which a device is worth while or not.
    pub fn bytes(&self) -> u64 {
        (self.count as u64).saturating_mul(3 * self.positions.number.bytes() as u64)
    }
}

impl Numbers {
    /// Fills in the strides of what lies side by side.
    fn with_strides(mut self) -> Self {
        if self.component_stride == 0 {
            self.component_stride = self.number.bytes();
        }
        if self.stride == 0 {
            self.stride = self.number.bytes() * self.components as isize;
        }
        self
    }
}

impl Particles for Borrowed {
    fn len(&self) -> usize {
        self.count
    }

    fn positions(&self, first: usize, out: &mut [[f64; 3]]) {
        assert!(first + out.len() <= self.count, "particles beyond the last");
        let from = &self.positions;
        // The fast ways of the library, for what lies as it has it itself.
        if from.number == MeniscusType::F32 && from.is_packed::<f32>() {
            // SAFETY: there and aligned; the caller leaves it as it is meanwhile.
            unsafe { from_raw_parts(from.at.cast::<[f32; 3]>(), self.count) }.positions(first, out);
        } else if from.number == MeniscusType::F64 && from.is_packed::<f64>() {
            // SAFETY: as above.
            unsafe { from_raw_parts(from.at.cast::<[f64; 3]>(), self.count) }.positions(first, out);
        } else {
            for (particle, to) in (first..).zip(out) {
                // SAFETY: the particle is there, as was looked at.
                *to = [0, 1, 2].map(|axis| unsafe { from.get(particle, axis) });
            }
        }
    }

    fn attributes(&self) -> &[AttributeInfo] {
        &self.attributes
    }

    fn attribute(&self, index: usize, first: usize, out: &mut [f32]) {
        let from = &self.values[index];
        assert!(first + out.len() / from.components <= self.count, "particles beyond the last");
        for (particle, to) in (first..).zip(out.chunks_exact_mut(from.components)) {
            for (component, to) in to.iter_mut().enumerate() {
                // SAFETY: the particle is there, as was looked at.
                *to = unsafe { from.get(particle, component) } as f32;
            }
        }
    }

    fn component(&self, (index, component): (usize, usize), first: usize, out: &mut [f64]) {
        let from = &self.values[index];
        assert!(component < from.components && first + out.len() <= self.count, "no such number");
        for (particle, to) in (first..).zip(out) {
            // SAFETY: the particle is there, as was looked at.
            *to = unsafe { from.get(particle, component) };
        }
    }

    fn integers(&self, index: usize, first: usize, out: &mut [i64]) {
        let from = &self.values[index];
        assert!(first + out.len() / from.components <= self.count, "particles beyond the last");
        for (particle, to) in (first..).zip(out.chunks_exact_mut(from.components)) {
            for (component, to) in to.iter_mut().enumerate() {
                // SAFETY: the particle is there, as was looked at. 32 bits are exact in f64.
                *to = unsafe { from.get(particle, component) } as i64;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::ptr::null;

    fn said() -> MeniscusParticles {
        MeniscusParticles {
            size: size_of::<MeniscusParticles>(),
            count: 2,
            positions: null(),
            stride: 0,
            component_stride: 0,
            attributes: null(),
            attribute_count: 0,
            number: 1,
            reserved: 0,
        }
    }

    fn read_all(particles: &Borrowed) -> Vec<[f64; 3]> {
        let mut all = vec![[0.0; 3]; particles.len()];
        particles.positions(0, &mut all);
        all
    }

    #[test]
    fn positions_are_read_in_any_order_from_any_place() {
        let expected = vec![[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]];
        let by_axis: [f64; 6] = [1.0, 4.0, 2.0, 5.0, 3.0, 6.0];
        let backwards: [f64; 6] = [6.0, 5.0, 4.0, 3.0, 2.0, 1.0];
        let narrow: [f32; 8] = [9.0, 1.0, 2.0, 3.0, 9.0, 4.0, 5.0, 6.0];
        let mut odd = vec![0_u8];
        odd.extend(by_axis.iter().flat_map(|x| x.to_ne_bytes()));
        let all = [
            MeniscusParticles {
                positions: by_axis.as_ptr().cast(),
                stride: 8,
                component_stride: 16,
                ..said()
            },
            MeniscusParticles {
                positions: odd[1..].as_ptr().cast(),
                stride: 8,
                component_stride: 16,
                ..said()
            },
            MeniscusParticles {
                positions: backwards[5..].as_ptr().cast(),
                stride: -24,
                component_stride: -8,
                ..said()
            },
            MeniscusParticles {
                positions: narrow[1..].as_ptr().cast(),
                stride: 16,
                number: 0,
                ..said()
            },
        ];
        for said in all {
            // SAFETY: the arrays are there.
            let particles = unsafe { Borrowed::new(&raw const said) }.unwrap();
            assert_eq!(read_all(&particles), expected, "{said:?}");
        }
    }

    #[test]
    fn what_no_memory_can_hold_is_refused() {
        let one = [0.0_f64; 3];
        let positions = one.as_ptr().cast();
        for said in [
            MeniscusParticles { positions, count: u64::MAX, ..said() },
            MeniscusParticles { positions, count: u64::MAX / 2, stride: 1, ..said() },
            MeniscusParticles { positions, count: 1 << 62, ..said() },
            MeniscusParticles { positions, stride: isize::MAX, ..said() },
            MeniscusParticles { positions, stride: isize::MIN, ..said() },
            MeniscusParticles { positions, component_stride: isize::MIN / 2, ..said() },
            MeniscusParticles { positions: null(), ..said() },
        ] {
            // SAFETY: nothing is read of it.
            let message = unsafe { Borrowed::new(&raw const said) }.unwrap_err().message;
            assert!(message.starts_with("particles."), "{message}");
        }
    }
}
