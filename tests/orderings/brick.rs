//! Tests of the slots that binning fills. The module `slots` is the library's file. The items
//! before it replace the items that the library's file imports from its parent module.

use loom::sync::atomic;

fn zeroed_in_huge_pages<T: Default>(len: usize) -> Vec<T> {
    (0..len).map(|_| T::default()).collect()
}

#[path = "../../src/brick/slots.rs"]
mod slots;

use atomic::{AtomicUsize, Ordering};
use loom::sync::Arc;
use loom::thread;
use slots::Slots;

/// Several threads fill slots of the same bins, as they do when spilled runs of particles are read.
#[test]
fn slots_have_all_values_after_the_threads_are_joined() {
    loom::model(|| {
        let slots = Arc::new(Slots::new(4, &[2]));
        let next = Arc::new(AtomicUsize::new(0));
        let fill = |records: [u64; 2]| {
            let (slots, next) = (Arc::clone(&slots), Arc::clone(&next));
            thread::spawn(move || {
                for (slot, record) in (next.fetch_add(2, Ordering::Relaxed)..).zip(records) {
                    slots.put(slot, record);
                    slots.put_attributes(slot, [record as f32, 0.5].into_iter());
                }
            })
        };
        let threads = [fill([1, 2]), fill([3, 4])];
        threads.into_iter().for_each(|thread| thread.join().unwrap());
        let slots = Arc::try_unwrap(slots).ok().expect("all threads are joined");
        let (mut records, attributes) = slots.into_parts();
        let of_each: Vec<f32> = records.iter().flat_map(|&record| [record as f32, 0.5]).collect();
        assert_eq!(attributes, [of_each], "each record has its attributes");
        records.sort_unstable();
        assert_eq!(records, [1, 2, 3, 4]);
    });
}
