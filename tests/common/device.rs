//! The Vulkan device on which the tests run. The validation layers check all calls, and the tests
//! check that work really runs on the device.

use std::cell::RefCell;
use std::fmt::Display;
use std::io::{self, Write};
use std::ops::Range;
use std::sync::{Arc, Mutex, OnceLock, PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard};

use meniscus::internals::backend::{Backend, Executor, Stages, Surfaces, Take, Vulkan, Work};
use meniscus::internals::brick::{Bins, DifField, Pages};
use meniscus::internals::field::indicator::PageRule;
use meniscus::internals::grid::CellBox;
use meniscus::internals::grid::units::MemoryBudget;
use meniscus::internals::surface::mesh::BlockMesh;
use meniscus::internals::system::control::{Control, Meter, Stage};
use meniscus::internals::vulkan::{
    Device, DeviceChoice, DeviceInfo, DeviceKind, DeviceOptions, Instance, ValidationLog,
    VulkanError,
};

/// A backend that runs frames on a device. The test fails if any work falls back to the CPU.
pub fn watched(device: Device) -> Result<Backend, VulkanError> {
    Ok(Backend::of(Watched(Vulkan::new(device)?)))
}

#[derive(Debug)]
struct Watched(Vulkan);

impl Executor for Watched {
    fn name(&self) -> String {
        self.0.name()
    }

    fn divides(&self) -> bool {
        self.0.divides()
    }

    fn host_bytes(&self, budget: MemoryBudget) -> u64 {
        self.0.host_bytes(budget)
    }

    fn start(&self, budget: MemoryBudget) -> Box<dyn Stages> {
        Box::new(WatchedStages { stages: self.0.start(budget), expected_work: Mutex::default() })
    }
}

#[derive(Debug)]
struct WatchedStages {
    stages: Box<dyn Stages>,
    expected_work: Mutex<Work>,
}

impl WatchedStages {
    /// Fails unless the device has done exactly the work `more` since the last check.
    fn assert_done(&self, more: Work) {
        let mut expected_work = self.expected_work.lock().unwrap();
        expected_work.pages += more.pages;
        expected_work.regions += more.regions;
        assert_eq!(self.stages.warnings(), [""; 0], "the backend gave warnings");
        assert_eq!(
            self.stages.on_device(),
            *expected_work,
            "the device did not do all of the work"
        );
    }
}

impl Stages for WatchedStages {
    fn indicate(
        &self,
        bins: &Bins,
        range: Range<usize>,
        rule: &PageRule,
        meter: &Meter<'_>,
    ) -> io::Result<Pages> {
        let pages = self.stages.indicate(bins, range.clone(), rule, meter)?;
        self.assert_done(Work { pages: range.len(), regions: 0 });
        Ok(pages)
    }

    fn field(&self, bins: &Arc<Bins>, rule: &PageRule, meter: &Meter<'_>) -> io::Result<DifField> {
        let field = self.stages.field(bins, rule, meter)?;
        self.assert_done(Work { pages: bins.keys().len(), regions: 0 });
        Ok(field)
    }

    fn contour(
        &self,
        surfaces: &Surfaces<'_>,
        regions: &[CellBox],
        meter: &Meter<'_>,
        take: &mut Take<'_>,
    ) -> io::Result<()> {
        self.stages.contour(surfaces, regions, meter, take)?;
        self.assert_done(Work { pages: 0, regions: regions.len() });
        Ok(())
    }

    fn warnings(&self) -> Vec<String> {
        self.stages.warnings()
    }

    fn on_device(&self) -> Work {
        self.stages.on_device()
    }
}

/// Meshes several regions of a field on the backend.
pub fn contoured(
    stages: &dyn Stages,
    surfaces: &Surfaces<'_>,
    regions: &[CellBox],
) -> Vec<Option<BlockMesh>> {
    let mut all = Vec::new();
    stages
        .contour(
            surfaces,
            regions,
            &Control::default().meter(Stage::Meshing, regions.len()),
            &mut |meshes| {
                all.extend(meshes);
                Ok(())
            },
        )
        .unwrap();
    all
}

/// Works around a bug in validation layers before 1.4.304 (issue 4391 of Vulkan-ValidationLayers):
/// in every Vulkan call, the layers read a table of instances and devices without a lock. While a
/// thread creates or frees an instance or a device, no other thread may therefore make a Vulkan
/// call. Tests that open a device lock `LAYER` for writing, and run alone. Tests on the shared
/// device lock `LAYER` for reading, and run in parallel.
static LAYER: RwLock<()> = RwLock::new(());

/// The lock that a thread holds on `LAYER`. The lock lasts until the thread ends, after the test
/// has freed its devices.
#[derive(Default)]
#[allow(dead_code, reason = "guards are held, but not used")]
enum Held {
    #[default]
    Not,
    Alone(RwLockWriteGuard<'static, ()>),
    Shared(RwLockReadGuard<'static, ()>),
}

thread_local! {
    static HELD: RefCell<Held> = const { RefCell::new(Held::Not) };
}

fn hold_alone() {
    if !HELD.with_borrow(|held| matches!(held, Held::Alone(_))) {
        // Release a read lock first. Otherwise, two threads that hold read locks would wait for
        // each other.
        HELD.take();
        HELD.set(Held::Alone(LAYER.write().unwrap_or_else(PoisonError::into_inner)));
    }
}

/// Chooses the device to test: the device that `MENISCUS_TEST_DEVICE` names, or the best device.
///
/// From this call on, the test runs alone. If `MENISCUS_REQUIRE_VULKAN` is `gpu` or `any`, the
/// validation layer is optional. If `MENISCUS_REQUIRE_VULKAN` is `gpu` and the chosen device
/// computes on the CPU, the test fails.
pub fn chosen() -> Result<(Arc<Instance>, DeviceInfo), VulkanError> {
    hold_alone();
    let required = std::env::var("MENISCUS_REQUIRE_VULKAN").unwrap_or_default();
    let [gpu, any] = ["gpu", "any"].map(|kind| required == kind);
    let instance = match Instance::connect(true) {
        Err(VulkanError::NoValidation) if gpu || any => {
            let _ = writeln!(io::stderr(), "without validation: the layer is not installed");
            Instance::connect(false)?
        }
        connected => connected?,
    };
    let choice =
        std::env::var("MENISCUS_TEST_DEVICE").map_or(DeviceChoice::Best, DeviceChoice::Named);
    let info = instance.choose(&choice)?;
    assert!(
        !gpu || info.kind != DeviceKind::Cpu,
        "MENISCUS_REQUIRE_VULKAN requires a GPU, but {} computes on the CPU",
        info.name
    );
    Ok((instance, info))
}

/// Opens the device to test.
pub fn open(options: &DeviceOptions) -> Result<(Device, ValidationLog), VulkanError> {
    let (instance, info) = chosen()?;
    let choice = DeviceChoice::Named(info.index.to_string());
    Ok((Device::open(&instance, &choice, options)?, instance.log()))
}

/// Returns the backend that all tests of a test program share, on one device. A test fails if its
/// work falls back to the CPU. If the validation layers have reported errors, this function fails
/// the calling test. A test that uses the shared device must not open another device.
pub fn shared() -> Result<Backend, &'static VulkanError> {
    static SHARED: OnceLock<Result<(Backend, ValidationLog), VulkanError>> = OnceLock::new();
    let open_watched = || {
        let (device, log) = open(&DeviceOptions::default())?;
        Ok((watched(device)?, log))
    };
    // Release this thread's lock first, because the thread that opens the device may wait for it.
    HELD.take();
    let opened = SHARED.get_or_init(open_watched);
    HELD.set(Held::Shared(match HELD.take() {
        Held::Alone(alone) => RwLockWriteGuard::downgrade(alone),
        _ => LAYER.read().unwrap_or_else(PoisonError::into_inner),
    }));
    let (backend, log) = opened.as_ref()?;
    assert_eq!(log.messages(), [""; 0]);
    Ok(backend.clone())
}

/// Prints that the calling test is skipped because there is no device. Fails the test if
/// `MENISCUS_REQUIRE_VULKAN` is set.
pub fn skip(why: impl Display) {
    assert!(
        std::env::var_os("MENISCUS_REQUIRE_VULKAN").is_none(),
        "MENISCUS_REQUIRE_VULKAN requires a Vulkan device: {why}"
    );
    let thread = std::thread::current();
    // Write to stderr directly, because the harness hides what passing tests print.
    let _ = writeln!(io::stderr(), "skipped: {}: {why}", thread.name().unwrap_or("a test"));
}
