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
    let no_window = !has("Xvfb") || !has("xdotool") || matches!(Gpu::new(), Err(GpuError::NoAdapter { .. }));
    let driven = || -> Result<(), Failed> {
        what_is_saved_is_what_render_renders();
        Ok(())
    };
    let trials = vec![
        trial("without_a_display_it_says_so", without_a_display_it_says_so),
        Trial::test("what_is_saved_is_what_render_renders", driven).with_ignored_flag(no_window),
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

fn what_is_saved_is_what_render_renders() {
    let folder = with_model();
    let mut server = Running(
        Command::new("Xvfb")
            .args(["-displayfd", "1", "-screen", "0", "900x700x24"])
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap(),
    );
    let mut number = String::new();
    BufReader::new(server.0.stdout.take().unwrap()).read_line(&mut number).unwrap();
    let display = format!(":{}", number.trim());
    let mut window = Running(
        relight(folder.path())
            .env("DISPLAY", &display)
            .args(["view", "m.relight", "--size", "800x600", "-o", "shot", "--light", SPOT])
            .stderr(Stdio::null())
            .spawn()
            .unwrap(),
    );
    let xdotool = |words: &str| {
        let output = Command::new("xdotool").env("DISPLAY", &display).args(words.split(' ')).output().unwrap();
        String::from_utf8(output.stdout).unwrap()
    };
    let id = until("the window", || xdotool("search --name relight").lines().next().map(str::to_owned));
    let press = |key: &str| {
        xdotool(&format!("windowfocus {id}"));
        xdotool(&format!("key {key}"));
    };
    // Until the window listens, and the light has moved.
    let saved = |name: &str| folder.path().join(name).exists().then_some(());
    until("the first lights", || {
        press("ctrl+l");
        saved("shot-001.toml")
    });
    press("Right");
    press("Right");
    std::thread::sleep(Duration::from_millis(500));
    press("ctrl+s");
    let (picture, number) = until("the picture", || {
        (1..20).find_map(|i| {
            saved(&format!("shot-{i:03}.exr")).map(|()| (folder.path().join(format!("shot-{i:03}.exr")), i))
        })
    });
    press("ctrl+l");
    let lights = until("the lights", || {
        (number..20).find_map(|i| saved(&format!("shot-{i:03}.toml")).map(|()| format!("shot-{i:03}.toml")))
    });
    press("ctrl+q");
    let status = until("the end", || window.0.try_wait().unwrap());
    assert!(status.success());

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
