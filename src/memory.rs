//! Where memory comes from and where it goes.

use std::sync::{Mutex, PoisonError};

use bytemuck::Zeroable;

/// What threads work with, as many as are in use at once, kept for the next job: rayon's own `map_init` makes it anew for every
/// part that is split off, which is nearly every chunk.
pub struct Spares<S, F> {
    make: F,
    idle: Mutex<Vec<S>>,
}

impl<S, F: Fn() -> S> Spares<S, F> {
    pub fn new(make: F) -> Self {
        Self { make, idle: Mutex::default() }
    }

    /// Lends one to `job`, in the state that the last job left it in.
    pub fn lend<R>(&self, job: impl FnOnce(&mut S) -> R) -> R {
        let idle = || self.idle.lock().unwrap_or_else(PoisonError::into_inner);
        let spare = idle().pop();
        let mut spare = spare.unwrap_or_else(&self.make);
        let result = job(&mut spare);
        idle().push(spare);
        result
    }
}

/// `len` zeros, not yet in memory: the threads that first touch them bring them there, two megabytes at a time where the system
/// lets them. In pages of four kilobytes a large matrix takes longer to bring than to write.
pub fn zeros<T: Zeroable>(len: usize) -> Vec<T> {
    let zeros = bytemuck::zeroed_vec(len);
    #[cfg(target_os = "linux")]
    ask_for_huge_pages(&zeros);
    zeros
}

#[cfg(target_os = "linux")]
fn ask_for_huge_pages<T>(array: &[T]) {
    use std::ffi::{c_int, c_void};
    unsafe extern "C" {
        fn madvise(address: *mut c_void, length: usize, advice: c_int) -> c_int;
    }
    const HUGE: usize = 2 << 20;
    /// As in sys/mman.h.
    const MADV_HUGEPAGE: c_int = 14;
    let bytes = array.as_ptr_range();
    let (start, end) = ((bytes.start as usize).next_multiple_of(HUGE), bytes.end as usize / HUGE * HUGE);
    if start < end {
        // SAFETY: a hint about pages that lie wholly in the array; it changes nothing that they hold. Where it is refused, the
        // pages are small.
        unsafe { madvise(start as *mut c_void, end - start, MADV_HUGEPAGE) };
    }
}

/// Makes the C library give large blocks back to the system as soon as they are freed, so that what is resident is what is in
/// use. By itself glibc keeps blocks of up to 32 MiB for later.
pub fn return_freed_memory() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    {
        use std::ffi::c_int;
        unsafe extern "C" {
            fn mallopt(param: c_int, value: c_int) -> c_int;
        }
        /// Blocks from this size on have pages of their own (malloc.h).
        const M_MMAP_THRESHOLD: c_int = -3;
        // SAFETY: glibc's own function, which takes any numbers.
        unsafe { mallopt(M_MMAP_THRESHOLD, 256 << 10) };
    }
}
