//! Progress on stderr: a bar when it is a terminal, a line every few seconds when it is not; the same lines in a log file; and
//! Ctrl-C.

use std::fs::File;
use std::io::{IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use crate::progress::Progress;

/// Seconds between lines where stderr is not a terminal.
const LINE_SECONDS: u64 = 5;

/// The program's [`Progress`].
pub struct Reporter {
    cancelled: Arc<AtomicBool>,
    terminal: bool,
    stage: Mutex<Option<Stage>>,
    done: AtomicU64,
    /// Milliseconds after the stage's start at which the next line is due.
    next_line: AtomicU64,
    /// Of what is done, as the bits of an f64; NaN where it is not known.
    noise: AtomicU64,
    log: Option<Mutex<File>>,
    stop: Arc<Stop>,
}

/// What is said when the work stops before its end.
#[derive(Default)]
struct Stop {
    /// The folder that keeps what was done.
    kept: Mutex<Option<PathBuf>>,
    /// A folder of what is not whole yet.
    scratch: Mutex<Option<PathBuf>>,
    said: AtomicBool,
}

impl Stop {
    fn clear(&self) {
        if let Some(folder) = self.scratch.lock().unwrap_or_else(|e| e.into_inner()).take() {
            // What cannot be removed is no reason to go on.
            let _ = std::fs::remove_dir_all(folder);
        }
    }

    fn say(&self) {
        if self.said.swap(true, Relaxed) {
            return;
        }
        match &*self.kept.lock().unwrap_or_else(|e| e.into_inner()) {
            Some(folder) => eprintln!(
                "stopped; what was baked is kept in {}: the same command goes on from there and gives the same result",
                folder.display()
            ),
            None => eprintln!("stopped; nothing was written. The same command starts again and gives the same result"),
        }
    }
}

/// What does not ask whether to stop is ended this long after Ctrl-C. Files are whole or not there at any moment.
const PATIENCE: Duration = Duration::from_millis(800);

struct Stage {
    what: String,
    unit: String,
    total: u64,
    start: Instant,
    /// What a unit is made of.
    things: Option<(u64, &'static str)>,
    bar: Option<ProgressBar>,
}

impl Stage {
    /// How fast `done` units were done, and their noise where it is known.
    fn speed_and_noise(&self, done: u64, noise: f64) -> String {
        let seconds = self.start.elapsed().as_secs_f64().max(1e-3);
        let (count, things) = self.things.unwrap_or((1, &self.unit));
        let speed = quantity(done as f64 * count as f64 / seconds);
        let noise = if noise.is_nan() { String::new() } else { format!("  noise {:.1} %", 100.0 * noise) };
        format!("{speed}{things}/s{noise}")
    }
}

/// Three digits and a prefix.
fn quantity(value: f64) -> String {
    match value {
        v if v >= 1e6 => format!("{:.1} M", v * 1e-6),
        v if v >= 1e3 => format!("{:.1} k", v * 1e-3),
        v => format!("{v:.1} "),
    }
}

impl Reporter {
    /// Takes over Ctrl-C and SIGTERM: they ask the work to stop, and end the program when it does not within a second.
    ///
    /// Every line goes to `log` as well.
    pub fn new(log: Option<File>) -> Self {
        let cancelled = Arc::new(AtomicBool::new(false));
        let flag = cancelled.clone();
        let stop = Arc::new(Stop::default());
        let said = stop.clone();
        // Without a handler, a stop is merely less polite.
        let _ = ctrlc::set_handler(move || {
            flag.store(true, Relaxed);
            std::thread::sleep(PATIENCE);
            said.clear();
            said.say();
            std::process::exit(1);
        });
        Self {
            cancelled,
            terminal: std::io::stderr().is_terminal(),
            stage: Mutex::new(None),
            done: AtomicU64::new(0),
            next_line: AtomicU64::new(0),
            noise: AtomicU64::new(f64::NAN.to_bits()),
            log: log.map(Mutex::new),
            stop,
        }
    }

    /// From now on, what is baked is kept in `folder`.
    pub fn keeps_in(&self, folder: &Path) {
        *self.stop.kept.lock().unwrap_or_else(|e| e.into_inner()) = Some(folder.to_owned());
    }

    /// What `folder` holds is removed where the program ends before its time.
    pub fn scratch(&self, folder: &Path) {
        *self.stop.scratch.lock().unwrap_or_else(|e| e.into_inner()) = Some(folder.to_owned());
    }

    /// Says, once, that the work was stopped, and how it goes on.
    pub fn say_stopped(&self) {
        self.stop.say();
    }

    /// One line on stderr and in the log.
    pub fn print(&self, line: &str) {
        self.write_to_log(line);
        match &*self.stage.lock().unwrap_or_else(|e| e.into_inner()) {
            Some(Stage { bar: Some(bar), .. }) => bar.suspend(|| eprintln!("{line}")),
            _ => eprintln!("{line}"),
        }
    }

    fn write_to_log(&self, line: &str) {
        if let Some(log) = &self.log {
            // The work is worth more than its log: a full disk does not end it.
            let _ = writeln!(log.lock().unwrap_or_else(|e| e.into_inner()), "{line}");
        }
    }
}

impl Progress for Reporter {
    fn begin(&self, what: &str, total: u64, unit: &str) {
        let bar = self.terminal.then(|| {
            let bar = ProgressBar::with_draw_target(Some(total), ProgressDrawTarget::stderr());
            let style = ProgressStyle::with_template(
                "{msg:<9}[{bar:20}] {human_pos}/{human_len} {prefix}  {elapsed} elapsed, {eta} left",
            );
            bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()).progress_chars("##."));
            bar.set_message(what.to_owned());
            bar.set_prefix(unit.to_owned());
            bar
        });
        self.done.store(0, Relaxed);
        self.next_line.store(LINE_SECONDS * 1000, Relaxed);
        let stage =
            Stage { what: what.to_owned(), unit: unit.to_owned(), total, start: Instant::now(), things: None, bar };
        self.noise.store(f64::NAN.to_bits(), Relaxed);
        *self.stage.lock().unwrap_or_else(|e| e.into_inner()) = Some(stage);
    }

    fn advance(&self, count: u64) {
        let done = self.done.fetch_add(count, Relaxed) + count;
        // Most calls only count; the lock is taken where something is to be shown.
        if let Ok(stage) = self.stage.try_lock()
            && let Some(stage) = &*stage
        {
            let told = || stage.speed_and_noise(done, f64::from_bits(self.noise.load(Relaxed)));
            if let Some(bar) = &stage.bar {
                bar.set_position(done);
                if bar.position() == done {
                    bar.set_prefix(format!("{}  {}", stage.unit, told()));
                }
            }
            let elapsed = stage.start.elapsed();
            let due = self.next_line.load(Relaxed);
            if elapsed.as_millis() as u64 >= due {
                self.next_line.store(due + LINE_SECONDS * 1000, Relaxed);
                let left = elapsed.mul_f64(stage.total.saturating_sub(done) as f64 / done.max(1) as f64);
                let Stage { what, unit, total, .. } = stage;
                let (elapsed, left) = (clock(elapsed), clock(left));
                let line = format!("{what:<9}{done}/{total} {unit}  {}  {elapsed} elapsed, {left} left", told());
                self.write_to_log(&line);
                if stage.bar.is_none() {
                    eprintln!("{line}");
                }
            }
        }
    }

    fn made_of(&self, count: u64, things: &'static str) {
        if let Some(stage) = &mut *self.stage.lock().unwrap_or_else(|e| e.into_inner()) {
            stage.things = Some((count, things));
        }
    }

    fn noise(&self, relative: f64) {
        self.noise.store(relative.to_bits(), Relaxed);
    }

    fn end(&self) {
        let stage = self.stage.lock().unwrap_or_else(|e| e.into_inner()).take();
        if let Some(stage) = stage {
            if let Some(bar) = &stage.bar {
                bar.finish_and_clear();
            }
            if !self.cancelled() {
                let told = stage.speed_and_noise(stage.total, f64::from_bits(self.noise.load(Relaxed)));
                let Stage { what, unit, total, start, .. } = stage;
                self.print(&format!("{what:<9}{total} {unit} in {:.1} s  {told}", start.elapsed().as_secs_f64()));
            }
        }
    }

    fn note(&self, line: &str) {
        self.print(line);
    }

    fn cancelled(&self) -> bool {
        self.cancelled.load(Relaxed)
    }
}

/// Minutes and seconds.
fn clock(duration: Duration) -> String {
    format!("{}:{:02}", duration.as_secs() / 60, duration.as_secs() % 60)
}
