//! Progress on stderr: a bar when it is a terminal, a line every few seconds when it is not; and Ctrl-C.

use std::io::IsTerminal;
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
}

struct Stage {
    what: String,
    unit: String,
    total: u64,
    start: Instant,
    bar: Option<ProgressBar>,
}

impl Reporter {
    /// Takes over Ctrl-C and SIGTERM: the first asks the work to stop, the second ends the program.
    pub fn new() -> Self {
        let cancelled = Arc::new(AtomicBool::new(false));
        let flag = cancelled.clone();
        // Without a handler, a stop is merely less polite.
        let _ = ctrlc::set_handler(move || {
            if flag.swap(true, Relaxed) {
                std::process::exit(130);
            }
        });
        Self {
            cancelled,
            terminal: std::io::stderr().is_terminal(),
            stage: Mutex::new(None),
            done: AtomicU64::new(0),
            next_line: AtomicU64::new(0),
        }
    }

    fn print(&self, line: &str) {
        match &*self.stage.lock().unwrap_or_else(|e| e.into_inner()) {
            Some(Stage { bar: Some(bar), .. }) => bar.suspend(|| eprintln!("{line}")),
            _ => eprintln!("{line}"),
        }
    }
}

impl Default for Reporter {
    fn default() -> Self {
        Self::new()
    }
}

impl Progress for Reporter {
    fn begin(&self, what: &str, total: u64, unit: &str) {
        let bar = self.terminal.then(|| {
            let bar = ProgressBar::with_draw_target(Some(total), ProgressDrawTarget::stderr());
            let style = ProgressStyle::with_template(
                "{msg:<9}[{bar:20}] {human_pos}/{human_len} {prefix}  {per_sec}  {elapsed} elapsed, {eta} left",
            );
            bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()).progress_chars("##."));
            bar.set_message(what.to_owned());
            bar.set_prefix(unit.to_owned());
            bar
        });
        self.done.store(0, Relaxed);
        self.next_line.store(LINE_SECONDS * 1000, Relaxed);
        let stage = Stage { what: what.to_owned(), unit: unit.to_owned(), total, start: Instant::now(), bar };
        *self.stage.lock().unwrap_or_else(|e| e.into_inner()) = Some(stage);
    }

    fn advance(&self, count: u64) {
        let done = self.done.fetch_add(count, Relaxed) + count;
        // Most calls only count; the lock is taken where something is to be shown.
        if let Ok(stage) = self.stage.try_lock()
            && let Some(stage) = &*stage
        {
            if let Some(bar) = &stage.bar {
                bar.set_position(done);
                return;
            }
            let elapsed = stage.start.elapsed();
            let due = self.next_line.load(Relaxed);
            if elapsed.as_millis() as u64 >= due {
                self.next_line.store(due + LINE_SECONDS * 1000, Relaxed);
                let left = elapsed.mul_f64(stage.total.saturating_sub(done) as f64 / done.max(1) as f64);
                let Stage { what, unit, total, .. } = stage;
                eprintln!("{what:<9}{done}/{total} {unit}  {} elapsed, {} left", clock(elapsed), clock(left));
            }
        }
    }

    fn end(&self) {
        let stage = self.stage.lock().unwrap_or_else(|e| e.into_inner()).take();
        if let Some(Stage { what, unit, total, start, bar }) = stage {
            if let Some(bar) = bar {
                bar.finish_and_clear();
            }
            if !self.cancelled() {
                eprintln!("{what:<9}{total} {unit} in {:.1} s", start.elapsed().as_secs_f64());
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

/// Largest resident memory of this process so far, where the system tells.
pub fn peak_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok().map(|kib| kib * 1024)
}
