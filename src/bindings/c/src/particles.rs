//! Particles in the caller's memory, read in place.

use std::ffi::c_char;
use std::slice::from_raw_parts;

use meniscus::Particles;
use meniscus::files::{AttributeInfo, AttributeKind, velocity_attribute};

use crate::sized::{SizedStruct, read};
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
    /// int32_t, 4 bytes; only for attributes.
    I32 = 2,
    /// uint32_t, 4 bytes; only for attributes.
    U32 = 3,
}

impl MeniscusType {
    /// Converts a number from the caller's structure, or returns an error if the number is invalid.
    fn of(number: i32, what: &str) -> Outcome<Self> {
        match number {
            0 => Ok(Self::F32),
            1 => Ok(Self::F64),
            2 => Ok(Self::I32),
            3 => Ok(Self::U32),
            _ => Err(Failure::request(format!("{what} is {number}, which is not a MeniscusType"))),
        }
    }
}

/// An attribute of the particles: one or several numbers per particle. Fill the structure with
/// zeros before you set fields.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct MeniscusAttribute {
    /// sizeof(MeniscusAttribute).
    pub size: usize,
    /// The name of the attribute, as used in the option "attributes" and on the vertices. By
    /// default, the vertices get only the attribute "velocity", if it has three components. Other
    /// common names of the velocity, such as "v" or "vel", are also recognised.
    pub name: *const c_char,
    /// The address of the first number of the first particle; need not be aligned.
    pub values: *const std::ffi::c_void,
    /// Bytes from one particle to the next; 0 if values are contiguous. May be negative.
    pub stride: isize,
    /// Bytes from one component of a particle to the next; 0 if components are contiguous. May be
    /// negative.
    pub component_stride: isize,
    /// Numbers per particle, from 1 to 65536.
    pub components: u32,
    /// The type of the numbers, one of MeniscusType. F32 and F64 are converted to float, and values
    /// that are not finite as float count as missing. I32 and U32, such as identifiers, are not
    /// interpolated: each vertex gets the exact values of the nearest particle
    /// (meniscus_mesh_attribute_whole).
    pub number: i32,
}

/// Particles in the caller's memory. Fill the structure with zeros before you set fields.
///
/// During a call, several threads of the library read the particles in place, several times. The
/// particles must not change until the call returns. Positions may have any unit of length, and all
/// other lengths have the same unit.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct MeniscusParticles {
    /// sizeof(MeniscusParticles).
    pub size: usize,
    /// The number of particles.
    pub count: u64,
    /// The address of the x coordinate of the first particle; need not be aligned.
    pub positions: *const std::ffi::c_void,
    /// Bytes from one particle's x to the next particle's x; 0 if positions are contiguous. May be
    /// negative.
    pub stride: isize,
    /// Bytes from x to y, and from y to z; 0 if coordinates are contiguous. May be negative.
    pub component_stride: isize,
    /// An array of attributes of the particles; NULL for none.
    pub attributes: *const MeniscusAttribute,
    /// Number of elements in `attributes`.
    pub attribute_count: usize,
    /// The type of the coordinates, MENISCUS_TYPE_F32 or MENISCUS_TYPE_F64.
    pub number: i32,
    /// Must be 0.
    pub reserved: i32,
}

// SAFETY: all fields are numbers or nullable pointers.
unsafe impl SizedStruct for MeniscusAttribute {
    const NAME: &str = "MeniscusAttribute";
}

// SAFETY: all fields are numbers or nullable pointers.
unsafe impl SizedStruct for MeniscusParticles {
    const NAME: &str = "MeniscusParticles";
}

/// Maximum number of components of an attribute, more than any simulator writes.
const MOST_COMPONENTS: u32 = 1 << 16;

/// Maximum number of attributes; a larger number is probably a mistake of the caller.
const MOST_ATTRIBUTES: usize = 1 << 16;

/// The memory layout of an attribute or of the positions, with constant strides.
#[derive(Debug, Clone, Copy)]
struct Numbers {
    at: *const u8,
    number: MeniscusType,
    stride: isize,
    component_stride: isize,
    components: usize,
}

impl Numbers {
    /// Returns an error if some numbers of `count` particles would lie outside the address space.
    fn check_address_range(&self, count: usize, what: &str) -> Outcome {
        if count == 0 {
            return Ok(());
        }
        if self.at.is_null() {
            return Err(Failure::request(format!("{what} is NULL, but count is {count}")));
        }
        let last_offset =
            |steps: usize, stride: isize| isize::try_from(steps - 1).ok()?.checked_mul(stride);
        let reach = || -> Option<()> {
            let ends = [
                last_offset(count, self.stride)?,
                last_offset(self.components, self.component_stride)?,
            ];
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
                "{what}: {count} particles with strides {strides:?} exceed the address space"
            ))
        })
    }

    /// Whether numbers are contiguous and aligned.
    fn is_packed<T>(&self) -> bool {
        let number = self.number.bytes();
        self.component_stride == number
            && self.stride == number * self.components as isize
            && self.at.cast::<T>().is_aligned()
    }

    /// Reads one component of a particle.
    ///
    /// # Safety
    /// The particle must exist, and its memory must be valid.
    unsafe fn get(&self, particle: usize, component: usize) -> f64 {
        let offset = particle as isize * self.stride + component as isize * self.component_stride;
        // SAFETY: the caller guarantees this number's memory, and `check_address_range` has
        // checked that no offset overflows.
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

    /// The kind of an attribute whose numbers have this type. The same rule applies to attributes
    /// in files.
    fn attribute_kind(self, info: &AttributeInfo) -> AttributeKind {
        match self {
            Self::F32 | Self::F64 => info.kind,
            _ if info.kind.is_colour() => AttributeKind::WholeColour,
            _ if velocity_attribute(std::slice::from_ref(info)).is_some() => AttributeKind::Number,
            Self::I32 => AttributeKind::Signed,
            Self::U32 => AttributeKind::Unsigned,
        }
    }
}

/// The caller's particles. [`new`](Self::new) checks their layout, but cannot check their memory.
#[derive(Debug)]
pub struct CallerParticles {
    count: usize,
    positions: Numbers,
    attributes: Vec<AttributeInfo>,
    values: Vec<Numbers>,
}

// SAFETY: `MeniscusParticles` allows several threads to read the caller's memory.
unsafe impl Sync for CallerParticles {}
// SAFETY: for the same reason as `Sync`.
unsafe impl Send for CallerParticles {}

impl CallerParticles {
    /// Reads and checks the caller's structure.
    ///
    /// # Safety
    /// `at` must be NULL or point to a structure with its size in its first field. Its attributes
    /// must also have their size in their first field. The particles' data must exist and stay
    /// unchanged as long as the result lives.
    pub unsafe fn new(at: *const MeniscusParticles) -> Outcome<Self> {
        // SAFETY: the caller upholds this function's contract.
        let raw = unsafe { read(at, "particles") }?;
        let number = MeniscusType::of(raw.number, "particles.number")?;
        if number.is_whole() {
            return Err(Failure::request(format!(
                "particles.number is {}, but must be MENISCUS_TYPE_F32 or MENISCUS_TYPE_F64",
                raw.number
            )));
        }
        if raw.reserved != 0 {
            return Err(Failure::request(format!(
                "particles.reserved is {}, but must be 0",
                raw.reserved
            )));
        }
        let Ok(count) = usize::try_from(raw.count) else {
            return Err(Failure::request(format!(
                "particles.count is {}, which is too large for this machine",
                raw.count
            )));
        };
        let positions = Numbers {
            at: raw.positions.cast(),
            number,
            stride: raw.stride,
            component_stride: raw.component_stride,
            components: 3,
        }
        .with_strides();
        positions.check_address_range(count, "particles.positions")?;
        let mut particles = Self { count, positions, attributes: Vec::new(), values: Vec::new() };
        // SAFETY: the caller upholds this function's contract.
        unsafe { particles.read_attributes(raw.attributes, raw.attribute_count) }?;
        Ok(particles)
    }

    /// Reads the array of attributes. The stride of the array is the size that its structures
    /// state, because the structures of a caller with an older header are smaller.
    ///
    /// # Safety
    /// The requirements of [`new`](Self::new).
    unsafe fn read_attributes(&mut self, at: *const MeniscusAttribute, count: usize) -> Outcome {
        if count == 0 {
            return Ok(());
        }
        if at.is_null() {
            return Err(Failure::request(format!(
                "particles.attributes is NULL, but attribute_count is {count}"
            )));
        }
        if count > MOST_ATTRIBUTES {
            return Err(Failure::request(format!(
                "particles.attribute_count is {count}, but must be at most {MOST_ATTRIBUTES}"
            )));
        }
        let mut size = 0;
        for index in 0..count {
            let what = format!("particles.attributes[{index}]");
            // SAFETY: the caller guarantees that the array is valid, and all previous elements have
            // `size` bytes.
            let raw = unsafe { read(at.byte_add(index * size), &what) }?;
            if index > 0 && raw.size != size {
                let sizes = format!("is {}, but {size} in previous attributes", raw.size);
                return Err(Failure::request(format!("{what}.size {sizes}")));
            }
            size = raw.size;
            // SAFETY: the caller upholds this function's contract.
            let name = unsafe { optional(raw.name, &format!("{what}.name")) }?;
            let name = name.filter(|name| !name.is_empty());
            let name =
                name.ok_or_else(|| Failure::request(format!("{what}.name is NULL or empty")))?;
            if self.attributes.iter().any(|info| info.name == name) {
                return Err(Failure::request(format!(
                    "{what}.name: another attribute is called {name:?}"
                )));
            }
            if !(1..=MOST_COMPONENTS).contains(&raw.components) {
                let range = format!("is {}, but must be 1 to {MOST_COMPONENTS}", raw.components);
                return Err(Failure::request(format!("{what}.components {range}")));
            }
            let numbers = Numbers {
                at: raw.values.cast(),
                number: MeniscusType::of(raw.number, &format!("{what}.number"))?,
                stride: raw.stride,
                component_stride: raw.component_stride,
                components: raw.components as usize,
            }
            .with_strides();
            numbers.check_address_range(self.count, &format!("{what}.values"))?;
            let info = AttributeInfo::new(name, numbers.components);
            let kind = numbers.number.attribute_kind(&info);
            self.attributes.push(AttributeInfo { kind, ..info });
            self.values.push(numbers);
        }
        Ok(())
    }

    /// Size, in bytes, of all positions. With the backend "auto", this size determines whether the
    /// library uses a device.
    pub fn bytes(&self) -> u64 {
        (self.count as u64).saturating_mul(3 * self.positions.number.bytes() as u64)
    }
}

impl Numbers {
    /// Replaces strides of 0 with the strides of contiguous numbers.
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

impl Particles for CallerParticles {
    fn len(&self) -> usize {
        self.count
    }

    fn positions(&self, first: usize, out: &mut [[f64; 3]]) {
        assert!(first + out.len() <= self.count, "particle index out of range");
        let from = &self.positions;
        // The library reads slices of contiguous positions faster than single numbers.
        if from.number == MeniscusType::F32 && from.is_packed::<f32>() {
            // SAFETY: `count` positions exist, contiguous and aligned, and the caller does not
            // change them meanwhile.
            unsafe { from_raw_parts(from.at.cast::<[f32; 3]>(), self.count) }.positions(first, out);
        } else if from.number == MeniscusType::F64 && from.is_packed::<f64>() {
            // SAFETY: for the same reasons as for f32.
            unsafe { from_raw_parts(from.at.cast::<[f64; 3]>(), self.count) }.positions(first, out);
        } else {
            for (particle, to) in (first..).zip(out) {
                // SAFETY: the index was checked above, so the particle exists.
                *to = [0, 1, 2].map(|axis| unsafe { from.get(particle, axis) });
            }
        }
    }

    fn attributes(&self) -> &[AttributeInfo] {
        &self.attributes
    }

    fn attribute(&self, index: usize, first: usize, out: &mut [f32]) {
        let from = &self.values[index];
        assert!(first + out.len() / from.components <= self.count, "particle index out of range");
        for (particle, to) in (first..).zip(out.chunks_exact_mut(from.components)) {
            for (component, to) in to.iter_mut().enumerate() {
                // SAFETY: the index was checked above, so the particle exists.
                *to = unsafe { from.get(particle, component) } as f32;
            }
        }
    }

    fn component(&self, (index, component): (usize, usize), first: usize, out: &mut [f64]) {
        let from = &self.values[index];
        assert!(
            component < from.components && first + out.len() <= self.count,
            "component or particle out of range"
        );
        for (particle, to) in (first..).zip(out) {
            // SAFETY: the index was checked above, so the particle exists.
            *to = unsafe { from.get(particle, component) };
        }
    }

    fn integers(&self, index: usize, first: usize, out: &mut [i64]) {
        let from = &self.values[index];
        assert!(first + out.len() / from.components <= self.count, "particle index out of range");
        for (particle, to) in (first..).zip(out.chunks_exact_mut(from.components)) {
            for (component, to) in to.iter_mut().enumerate() {
                // f64 represents all 32-bit integers exactly.
                // SAFETY: the index was checked above, so the particle exists.
                *to = unsafe { from.get(particle, component) } as i64;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::ptr::null;

    fn two_particles() -> MeniscusParticles {
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

    fn read_all(particles: &CallerParticles) -> Vec<[f64; 3]> {
        let mut all = vec![[0.0; 3]; particles.len()];
        particles.positions(0, &mut all);
        all
    }

    #[test]
    fn positions_are_read_with_any_alignment_stride_and_number_type() {
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
                ..two_particles()
            },
            MeniscusParticles {
                positions: odd[1..].as_ptr().cast(),
                stride: 8,
                component_stride: 16,
                ..two_particles()
            },
            MeniscusParticles {
                positions: backwards[5..].as_ptr().cast(),
                stride: -24,
                component_stride: -8,
                ..two_particles()
            },
            MeniscusParticles {
                positions: narrow[1..].as_ptr().cast(),
                stride: 16,
                number: 0,
                ..two_particles()
            },
        ];
        for structure in all {
            // SAFETY: the arrays live longer than `particles`.
            let particles = unsafe { CallerParticles::new(&raw const structure) }.unwrap();
            assert_eq!(read_all(&particles), expected, "{structure:?}");
        }
    }

    #[test]
    fn positions_that_cannot_fit_in_memory_are_refused() {
        let one = [0.0_f64; 3];
        let positions = one.as_ptr().cast();
        for structure in [
            MeniscusParticles { positions, count: u64::MAX, ..two_particles() },
            MeniscusParticles { positions, count: u64::MAX / 2, stride: 1, ..two_particles() },
            MeniscusParticles { positions, count: 1 << 62, ..two_particles() },
            MeniscusParticles { positions, stride: isize::MAX, ..two_particles() },
            MeniscusParticles { positions, stride: isize::MIN, ..two_particles() },
            MeniscusParticles { positions, component_stride: isize::MIN / 2, ..two_particles() },
            MeniscusParticles { positions: null(), ..two_particles() },
        ] {
            // SAFETY: `new` rejects the structure before it reads any position.
            let message =
                unsafe { CallerParticles::new(&raw const structure) }.unwrap_err().message;
            assert!(message.starts_with("particles."), "{message}");
        }
    }
}
