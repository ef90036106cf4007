//! The path traced picture of the present lights, made on a thread of its own, a pass at a time.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::Scope;

use crate::light::Light;
use crate::model::{Picture, View};
use crate::progress::Progress;
use crate::scene::{Asset, Tracer};

/// Path traces the direct and the indirect light of a view: some paths a pixel, from a seed. None where it was cancelled.
pub type PathTrace = fn(&Tracer, &View, &[Light], u32, u64, &dyn Progress) -> Option<[Picture; 2]>;

/// Paths a pixel of one pass, at most, and of all.
const LONGEST: u32 = 16;
const ENOUGH: u32 = 4096;

/// Asks for pictures and takes them. Dropped, it ends its thread.
pub struct Reference {
    jobs: Sender<Job>,
    pictures: Receiver<Traced>,
    /// The newest job's number; work on older ones ends.
    newest: Arc<AtomicU64>,
}

struct Job {
    number: u64,
    view: View,
    lights: Vec<Light>,
}

/// The mean of the passes so far.
pub struct Traced {
    number: u64,
    pub direct: Picture,
    pub indirect: Picture,
    /// Paths a pixel.
    pub paths: u32,
}

impl Reference {
    /// Starts the thread. `notify` is called whenever there is a new picture.
    pub fn start<'s, 'e>(
        scope: &'s Scope<'s, 'e>,
        asset: &'e Asset,
        trace: PathTrace,
        notify: impl Fn() + Send + 's,
    ) -> Self {
        let (jobs, orders) = channel::<Job>();
        let (finished, pictures) = channel();
        let newest = Arc::new(AtomicU64::new(0));
        let current = newest.clone();
        scope.spawn(move || {
            // One core is left for the window.
            let threads = std::thread::available_parallelism().map_or(1, |n| n.get().saturating_sub(1).max(1));
            let Ok(pool) = rayon::ThreadPoolBuilder::new().num_threads(threads).build() else { return };
            let tracer = Tracer::new(asset);
            while let Ok(job) = orders.recv() {
                let cancel = Cancel { number: job.number, newest: &current };
                work(
                    &job,
                    &|view, lights, count, seed| pool.install(|| trace(&tracer, view, lights, count, seed, &cancel)),
                    &cancel,
                    |traced| {
                        let sent = finished.send(traced).is_ok();
                        notify();
                        sent
                    },
                );
            }
        });
        Self { jobs, pictures, newest }
    }

    /// Begins anew, with this view and these lights.
    pub fn ask(&self, view: View, lights: &[Light]) {
        let number = self.newest.fetch_add(1, Ordering::Relaxed) + 1;
        // The thread ends only when this side does.
        _ = self.jobs.send(Job { number, view, lights: lights.to_vec() });
    }

    /// Stops what is being worked on.
    pub fn stop(&self) {
        self.newest.fetch_add(1, Ordering::Relaxed);
    }

    /// The latest picture of what was asked for last, if there is a new one.
    pub fn take(&self) -> Option<Traced> {
        let newest = self.newest.load(Ordering::Relaxed);
        self.pictures.try_iter().filter(|traced| traced.number == newest).last()
    }
}

impl Drop for Reference {
    fn drop(&mut self) {
        self.stop();
    }
}

struct Cancel<'a> {
    number: u64,
    newest: &'a AtomicU64,
}

impl Progress for Cancel<'_> {
    fn begin(&self, _: &str, _: u64, _: &str) {}
    fn advance(&self, _: u64) {}
    fn end(&self) {}
    fn note(&self, _: &str) {}
    fn cancelled(&self) -> bool {
        self.newest.load(Ordering::Relaxed) != self.number
    }
}

/// Some paths a pixel, from a seed.
type Pass<'a> = dyn Fn(&View, &[Light], u32, u64) -> Option<[Picture; 2]> + 'a;

fn work(job: &Job, trace: &Pass, cancel: &Cancel, mut show: impl FnMut(Traced) -> bool) {
    let (mut paths, mut seed) = (0, 0);
    let mut sums: Option<[Picture; 2]> = None;
    while paths < ENOUGH && !cancel.cancelled() {
        // Each pass doubles what there is, until passes are long.
        let count = paths.clamp(1, LONGEST);
        let Some(pass) = trace(&job.view, &job.lights, count, seed) else { return };
        let sums = sums.get_or_insert_with(|| {
            pass.clone().map(|picture| Picture { pixels: vec![Default::default(); picture.pixels.len()], ..picture })
        });
        for (sum, pass) in sums.iter_mut().zip(&pass) {
            sum.pixels.iter_mut().zip(&pass.pixels).for_each(|(sum, &p)| *sum += p * count as f32);
        }
        (paths, seed) = (paths + count, seed + 1);
        let [direct, indirect] = sums.clone().map(|sum| {
            let pixels = sum.pixels.iter().map(|&p| p / paths as f32).collect();
            Picture { pixels, ..sum }
        });
        if !show(Traced { number: job.number, direct, indirect, paths }) {
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use std::time::{Duration, Instant};

    use super::*;
    use crate::math::Rgb;
    use crate::scene::{Camera, generate};

    /// Each pass is as bright as its seed: the mean over all passes weighs them by their paths.
    fn bright_as_seed(
        _: &Tracer,
        view: &View,
        _: &[Light],
        count: u32,
        seed: u64,
        _: &dyn Progress,
    ) -> Option<[Picture; 2]> {
        let picture =
            |value: f32| Picture { width: view.width, height: view.height, pixels: vec![Rgb::splat(value); 4] };
        Some([picture(seed as f32), picture(count as f32)])
    }

    #[test]
    fn passes_are_averaged_by_their_paths_and_a_new_job_begins_anew() {
        let asset = generate("cornell").unwrap();
        let view = View::new(Camera { up: glam::Vec3::Y, ..asset.cameras[0].clone() }, 2, 2);
        std::thread::scope(|scope| {
            let reference = Reference::start(scope, &asset, bright_as_seed, || ());
            for _ in 0..2 {
                reference.ask(view.clone(), &[]);
                let start = Instant::now();
                let last = loop {
                    assert!(start.elapsed() < Duration::from_secs(60), "it ends");
                    match reference.take() {
                        Some(traced) if traced.paths >= ENOUGH => break traced,
                        _ => std::thread::sleep(Duration::from_millis(1)),
                    }
                };
                // Passes of 1, 1, 2, 4, 8, then of 16: the mean count is Σ n² / Σ n.
                let counts = [1.0f32, 1.0, 2.0, 4.0, 8.0].into_iter().chain(std::iter::repeat_n(16.0, 255));
                let (all, squares) = counts.fold((0.0, 0.0), |(a, s), n| (a + n, s + n * n));
                assert_eq!(last.paths, all as u32);
                let mean = last.indirect.pixels[0].x;
                assert!((mean - squares / all).abs() < 1e-3, "{mean}");
            }
        });
    }
}
