//! The window, driven from outside as a user would: on a virtual display, where there is one to be had.

mod common;

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use common::trial;
use libtest_mimic::{Arguments, Failed, Trial};
use relight::gpu::{Gpu, GpuError};

const SPOT: &str = r#"{type="spot", position=[2.8,4,1], direction=[0.2,-0.8,0.5], intensity=20, outer_cone_angle=0.7}"#;

fn main() {
    let has =
        |tool: &str| Command::new(tool).arg("-version").stderr(Stdio::null()).stdout(Stdio::null()).status().is_ok();
    let no_window =
        !has("Xvfb") || !has("xdotool") || !has("import") || matches!(Gpu::new(), Err(GpuError::NoAdapter { .. }));
    let driven = |name: &str, body: fn()| {
        let run = move || -> Result<(), Failed> {
            body();
            Ok(())
        };
        Trial::test(name, run).with_ignored_flag(no_window)
    };
    let trials = vec![
        trial("without_a_display_it_says_so", without_a_display_it_says_so),
        driven("what_is_saved_is_what_render_renders", what_is_saved_is_what_render_renders),
        driven("the_difference_is_shown_in_false_colour", the_difference_is_shown_in_false_colour),
    ];
    libtest_mimic::run(&Arguments::from_args(), trials).exit();
}

fn relight(folder: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_relight"));
    command.current_dir(folder).env_remove("DISPLAY").env_remove("WAYLAND_DISPLAY").env_remove("WAYLAND_SOCKET");
    command
}

fn with_model() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let words = "train --size 16 --conditions 24 --held-out 8 --paths 4 --points 16 --basis 4 -o m.relight";
    let output = relight(folder.path()).args(words.split(' ')).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    folder
}

fn without_a_display_it_says_so() {
    if !cfg!(target_os = "linux") {
        return;
    }
    let folder = with_model();
    let output = relight(folder.path()).args(["view", "m.relight"]).output().unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{stderr}");
    assert!(stderr.lines().last().unwrap().starts_with("error: no window can be opened: "), "{stderr}");
    assert!(!stderr.contains(".rs"), "{stderr}");
}

/// Ends its process with itself.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        _ = self.0.kill();
        _ = self.0.wait();
    }
}

/// Waits for `done`, a minute at most.
fn until<T>(what: &str, mut done: impl FnMut() -> Option<T>) -> T {
    let start = Instant::now();
    loop {
        if let Some(value) = done() {
            return value;
        }
        assert!(start.elapsed() < Duration::from_secs(60), "waited for {what}");
        std::thread::sleep(Duration::from_millis(100));
    }
}

/// A window on a display of its own.
struct Window {
    program: Running,
    _server: Running,
    display: String,
    id: String,
}

impl Window {
    /// Opens `relight view` of `models` in `folder`, as large as its screen.
    fn open(folder: &Path, size: &str, models: &[&str]) -> Self {
        let mut server = Running(
            Command::new("Xvfb")
                // Without `-noreset` it starts anew, closing every connection, when its last client leaves: here the
                // search for the window, before the program has connected.
                .args(["-noreset", "-displayfd", "1", "-screen", "0", &format!("{size}x24")])
                .stdout(Stdio::piped())
                .stderr(Stdio::null())
                .spawn()
                .unwrap(),
        );
        let mut number = String::new();
        BufReader::new(server.0.stdout.take().unwrap()).read_line(&mut number).unwrap();
        let display = format!(":{}", number.trim());
        let said = folder.join("view.log");
        let program = Running(
            relight(folder)
                .env("DISPLAY", &display)
                .args([&["view"], models, &["--size", size, "-o", "shot", "--light", SPOT]].concat())
                .stderr(std::fs::File::create(&said).unwrap())
                .spawn()
                .unwrap(),
        );
        let mut window = Self { program, _server: server, display, id: String::new() };
        window.id = until("the window", || {
            let ended = window.program.0.try_wait().unwrap();
            assert!(ended.is_none(), "{ended:?}: {}", std::fs::read_to_string(&said).unwrap());
            window.xdotool("search --name relight").lines().next().map(str::to_owned)
        });
        window
    }

    fn xdotool(&self, words: &str) -> String {
        let output = Command::new("xdotool").env("DISPLAY", &self.display).args(words.split(' ')).output().unwrap();
        String::from_utf8(output.stdout).unwrap()
    }

    fn press(&self, key: &str) {
        self.xdotool(&format!("windowfocus {}", self.id));
        self.xdotool(&format!("key {key}"));
    }

    /// What the screen shows.
    fn screen(&self, folder: &Path) -> image::RgbImage {
        let path = folder.join("screen.png");
        let arguments = ["-window", "root", path.to_str().unwrap()];
        assert!(Command::new("import").env("DISPLAY", &self.display).args(arguments).status().unwrap().success());
        image::open(path).unwrap().into_rgb8()
    }

    fn quit(mut self) {
        self.press("ctrl+q");
        let status = until("the end", || self.program.0.try_wait().unwrap());
        assert!(status.success());
    }
}

fn what_is_saved_is_what_render_renders() {
    let folder = with_model();
    let window = Window::open(folder.path(), "800x600", &["m.relight"]);
    // Until the window listens, and the light has moved.
    let saved = |name: &str| folder.path().join(name).exists().then_some(());
    until("the first lights", || {
        window.press("ctrl+l");
        saved("shot-001.toml")
    });
    window.press("Right");
    window.press("Right");
    std::thread::sleep(Duration::from_millis(500));
    window.press("ctrl+s");
    let (picture, number) = until("the picture", || {
        (1..20).find_map(|i| {
            saved(&format!("shot-{i:03}.exr")).map(|()| (folder.path().join(format!("shot-{i:03}.exr")), i))
        })
    });
    window.press("ctrl+l");
    let lights = until("the lights", || {
        (number..20).find_map(|i| saved(&format!("shot-{i:03}.toml")).map(|()| format!("shot-{i:03}.toml")))
    });
    // The light goes around; its path is one that `render` renders.
    window.press("space");
    let path = until("the path", || {
        window.press("ctrl+p");
        (number..20).find_map(|i| saved(&format!("shot-{i:03}.path.toml")).map(|()| format!("shot-{i:03}.path.toml")))
    });
    window.quit();
    let render = |words: &str| {
        let words = format!("render m.relight --cpu --size 32x24 --exposure 0.5 {words}");
        let output = relight(folder.path()).args(words.split(' ')).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    };
    let codes = |name: &str| image::open(folder.path().join(name)).unwrap().into_rgb8().into_raw();
    render(&format!("--path {path} --frames 4 -o frames"));
    render(&format!("--light {lights} -o still.png"));
    assert_eq!(codes("frames/0000.png"), codes("still.png"), "the path begins where the light stood");
    assert_ne!(codes("frames/0002.png"), codes("still.png"), "half way around it is elsewhere");

    let (size, shown) = read_exr(&picture);
    let rendered = |lights: &str| {
        let size = format!("{}x{}", size.0, size.1);
        let output = relight(folder.path())
            .args(["render", "m.relight", "--light", lights, "--size", &size, "-o", "r.exr"])
            .output()
            .unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        read_exr(&folder.path().join("r.exr")).1
    };
    let difference = |a: &[[f32; 3]], b: &[[f32; 3]]| {
        let squares = |v: &mut dyn Iterator<Item = f32>| v.map(|d| (d as f64).powi(2)).sum::<f64>();
        let apart = squares(&mut a.as_flattened().iter().zip(b.as_flattened()).map(|(a, b)| a - b));
        (apart / squares(&mut b.as_flattened().iter().copied())).sqrt()
    };
    // The same passes on the same adapter; the lights went through TOML, which keeps f32 as it is.
    assert!(difference(&shown, &rendered(&lights)) < 1e-4, "{}", difference(&shown, &rendered(&lights)));
    // Control: where the light was before it was moved.
    assert!(difference(&shown, &rendered(SPOT)) > 1e-2);
}

/// Linear radiance, row by row.
fn read_exr(path: &Path) -> ((usize, usize), Vec<[f32; 3]>) {
    let read = || {
        exr::prelude::read_first_rgba_layer_from_file(
            path,
            |size, _| (size.width(), vec![[0.0; 3]; size.area()]),
            |(width, pixels), at, (r, g, b, _): (f32, f32, f32, f32)| pixels[at.y() * *width + at.x()] = [r, g, b],
        )
        .ok()
    };
    let image = until("the whole picture", read);
    let size = image.layer_data.size;
    ((size.width(), size.height()), image.layer_data.channel_data.pixels.1)
}

/// The share of the right half of the scene whose colours are those of a difference.
fn false_coloured(screen: &image::RgbImage) -> f32 {
    let scale: Vec<[u8; 3]> = (0..=255).map(|i| relight::math::colour::false_colour(i as f32 / 255.0)).collect();
    let on_scale = |pixel: [u8; 3]| scale.iter().any(|c| (0..3).all(|i| pixel[i].abs_diff(c[i]) <= 3));
    // Between the split line and the right panel, under the label.
    let inside: Vec<[u8; 3]> =
        (60..600).step_by(3).flat_map(|y| (660..960).step_by(3).map(move |x| screen.get_pixel(x, y).0)).collect();
    inside.iter().filter(|&&pixel| on_scale(pixel)).count() as f32 / inside.len() as f32
}

/// Three methods of one asset in one window: the difference of each from a path traced picture of the same light.
fn the_difference_is_shown_in_false_colour() {
    let folder = with_model();
    for method in ["linear", "belcour"] {
        let words = format!(
            "train --size 16 --conditions 24 --held-out 8 --paths 4 --points 16 --basis 4 --method {method} -o {method}.relight"
        );
        let output = relight(folder.path()).args(words.split(' ')).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    }
    let window = Window::open(folder.path(), "1280x720", &["m.relight", "linear.relight", "belcour.relight"]);
    until("the first lights", || {
        window.press("ctrl+l");
        folder.path().join("shot-001.toml").exists().then_some(())
    });
    // Handles are drawn over the picture.
    window.press("h");
    window.press("r");
    let share = || false_coloured(&window.screen(folder.path()));
    // The right side is path traced, and not yet compared.
    std::thread::sleep(Duration::from_secs(2));
    assert!(share() < 0.5, "control: {}", share());
    window.press("c");
    until("the difference", || (share() > 0.95).then_some(()));
    // Of another model, too.
    window.press("x");
    window.press("x");
    until("two models", || (share() < 0.5).then_some(()));
    window.quit();
}
