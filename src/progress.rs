//! How long-running work tells how far it is, and learns that it should stop.

/// Told by workers how far they are; asked by them whether to go on. Shared between threads.
pub trait Progress: Sync {
    /// A new stage begins: `what` is one word for the line ("bake"), `total` counts `unit`s ("texels").
    fn begin(&self, what: &str, total: u64, unit: &str);
    /// `count` more units of the present stage are done.
    fn advance(&self, count: u64);
    /// Each unit of the present stage stands for `count` `things` ("paths"), in which its speed is told.
    fn made_of(&self, _count: u64, _things: &'static str) {}
    /// The noise of what is done of the present stage, relative.
    fn noise(&self, _relative: f64) {}
    /// The present stage is over.
    fn end(&self);
    /// One line that the user should read, such as a choice made and its reason.
    fn note(&self, line: &str);
    /// Whether the user asked to stop. Workers ask at least every few hundred milliseconds.
    fn cancelled(&self) -> bool;
}

/// Says nothing and never cancels.
pub struct Silent;

impl Progress for Silent {
    fn begin(&self, _: &str, _: u64, _: &str) {}
    fn advance(&self, _: u64) {}
    fn end(&self) {}
    fn note(&self, _: &str) {}
    fn cancelled(&self) -> bool {
        false
    }
}
