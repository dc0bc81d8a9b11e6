//! The Vulkan device that tests run on, with everything that it does validated.

use std::sync::{Arc, OnceLock};

use meniscus::backend::Vulkan;
use meniscus::vulkan::{Device, DeviceChoice, DeviceOptions, Instance, ValidationLog};

/// A device of its own, or `None`, aloud, where there is none and `MENISCUS_REQUIRE_VULKAN` does not demand one.
pub fn open(options: &DeviceOptions) -> Option<(Device, ValidationLog)> {
    let opened = Instance::connect(true).and_then(|instance| {
        let log = instance.log();
        Ok((Device::open(&instance, &DeviceChoice::Best, options)?, log))
    });
    match opened {
        Ok(opened) => Some(opened),
        Err(error) if std::env::var_os("MENISCUS_REQUIRE_VULKAN").is_none() => {
            eprintln!("skipped on Vulkan: {error}");
            None
        }
        Err(error) => panic!("a Vulkan device is demanded: {error}"),
    }
}

/// One for all tests of a file. What validation has found by now fails the test that asks.
pub fn shared() -> Option<Arc<Vulkan>> {
    static SHARED: OnceLock<Option<(Arc<Vulkan>, ValidationLog)>> = OnceLock::new();
    let (vulkan, log) = SHARED
        .get_or_init(|| {
            let (device, log) = open(&DeviceOptions::default())?;
            Some((Arc::new(Vulkan::new(device).unwrap()), log))
        })
        .as_ref()?;
    assert_eq!(log.messages(), [""; 0]);
    Some(Arc::clone(vulkan))
}
