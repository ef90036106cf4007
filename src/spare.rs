//! What a thread works with, kept for the next job: rayon's own `map_init` makes it anew for every part that is split off, which
//! is nearly every chunk.

use std::sync::{Mutex, PoisonError};

/// Makes as many as are in use at once.
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
