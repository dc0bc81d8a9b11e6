//! The choice among the queue families of a device.

use ash::vk;

/// Returns the queue family for shaders, without graphics if possible, and a family that supports
/// only copies, if there is one. Families that also support video are not used for copies.
pub(super) fn choose_families(known: &[vk::QueueFamilyProperties]) -> (Option<u32>, Option<u32>) {
    let find = |wanted: vk::QueueFlags, unwanted: vk::QueueFlags| {
        let fits = |f: &vk::QueueFamilyProperties| {
            f.queue_flags.contains(wanted) && !f.queue_flags.intersects(unwanted)
        };
        known.iter().position(fits).map(|i| i as u32)
    };
    let (compute, copy) = (vk::QueueFlags::COMPUTE, vk::QueueFlags::TRANSFER);
    let computes =
        find(compute, vk::QueueFlags::GRAPHICS).or(find(compute, vk::QueueFlags::empty()));
    let harmless = vk::QueueFlags::SPARSE_BINDING | vk::QueueFlags::PROTECTED;
    (computes, find(copy, !(copy | harmless)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shaders_avoid_the_graphics_family_and_copies_use_a_dedicated_family() {
        let [all, shaders, copies, videos, graphics] = [
            vk::QueueFlags::GRAPHICS | vk::QueueFlags::COMPUTE | vk::QueueFlags::TRANSFER,
            vk::QueueFlags::COMPUTE | vk::QueueFlags::TRANSFER,
            vk::QueueFlags::TRANSFER | vk::QueueFlags::SPARSE_BINDING,
            vk::QueueFlags::TRANSFER | vk::QueueFlags::VIDEO_DECODE_KHR,
            vk::QueueFlags::GRAPHICS,
        ];
        for (flags, expected) in [
            (&[all, copies, shaders, videos][..], (Some(2), Some(1))),
            (&[videos, all, copies], (Some(1), Some(2))),
            (&[videos, all], (Some(1), None)),
            (&[shaders], (Some(0), None)),
            (&[graphics], (None, None)),
        ] {
            let family =
                |&flags| vk::QueueFamilyProperties { queue_flags: flags, ..Default::default() };
            let families: Vec<_> = flags.iter().map(family).collect();
            assert_eq!(choose_families(&families), expected, "{flags:?}");
        }
    }
}
