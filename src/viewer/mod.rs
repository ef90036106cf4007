//! The window: an asset under lights that move, relit as they do.
//!
//! The scene is drawn on the window's own device, as finely as the time for a frame allows; the path traced picture beside it is
//! made on a thread of its own. What is asked of the GPU is asked when something changed, and not before.

mod app;
pub mod control;
pub mod display;
mod dropped;
pub mod handles;
pub mod pace;
mod panels;
mod player;
pub mod reference;
mod save;
pub mod screen;

use std::path::PathBuf;

use eframe::egui;
use eframe::egui_wgpu::{WgpuConfiguration, WgpuSetup, WgpuSetupCreateNew};

use crate::gpu::{Gpu, GpuError};
use crate::light::{Light, LightPath};
use crate::model::Model;
use crate::scene::{Camera, Tracer};
pub use reference::PathTrace;

/// What the window opens with.
pub struct Opening<'a> {
    /// Names and models, all of one asset; the first is shown.
    pub models: &'a [(String, Model)],
    pub lights: Vec<Light>,
    /// Lights that play in the place of these.
    pub path: Option<LightPath>,
    pub camera: Camera,
    /// What path traces the reference.
    pub path_trace: PathTrace,
    /// What saved files' names begin with.
    pub stem: PathBuf,
    /// Points.
    pub size: [f32; 2],
}

#[derive(Debug, thiserror::Error)]
pub enum ViewerError {
    #[error("no window can be opened: {0}; on a machine without a display use `relight render`")]
    NoDisplay(String),
    #[error(transparent)]
    Gpu(#[from] GpuError),
    #[error("the window failed: {0}")]
    Failed(String),
}

/// Opens the window and returns when it is closed.
///
/// # Errors
/// No display, no adapter, or a device that fails.
pub fn run(opening: Opening) -> Result<(), ViewerError> {
    let options = eframe::NativeOptions {
        viewport: egui::ViewportBuilder::default()
            .with_title(format!("{} – relight", opening.models[0].0))
            .with_app_id("relight")
            .with_inner_size(opening.size)
            .with_drag_and_drop(true),
        wgpu_options: WgpuConfiguration { wgpu_setup: setup(), ..Default::default() },
        ..Default::default()
    };
    let tracer = Tracer::new(&opening.models[0].1.asset);
    std::thread::scope(|scope| {
        let create: eframe::AppCreator<'_> = Box::new(|context| {
            let window = context.wgpu_render_state.clone().ok_or("the window has no GPU device")?;
            let notify = context.egui_ctx.clone();
            let asset = &opening.models[0].1.asset;
            let reference =
                reference::Reference::start(scope, asset, opening.path_trace, move || notify.request_repaint());
            Ok(Box::new(app::App::new(opening, &tracer, window, reference)))
        });
        eframe::run_native("relight", options, create).map_err(failure)
    })
}

/// A device as [`Gpu::new`] opens it, on an adapter that can draw to the window.
fn setup() -> WgpuSetup {
    let new = WgpuSetupCreateNew {
        native_adapter_selector: Some(std::sync::Arc::new(|adapters, surface| {
            let able = |adapter: &&wgpu::Adapter| surface.is_none_or(|surface| adapter.is_surface_supported(surface));
            Gpu::best(adapters.iter().filter(able).cloned()).map_err(|error| error.to_string())
        })),
        device_descriptor: std::sync::Arc::new(Gpu::descriptor),
        ..WgpuSetupCreateNew::without_display_handle()
    };
    new.into()
}

fn failure(error: eframe::Error) -> ViewerError {
    // What the window system says begins with places in its own source.
    let reason = |text: String| {
        text.rsplit(".rs:")
            .next()
            .unwrap_or_default()
            .trim_end_matches('.')
            .trim_start_matches(char::is_numeric)
            .trim_start_matches(": ")
            .to_owned()
    };
    match error {
        eframe::Error::WinitEventLoop(error) => ViewerError::NoDisplay(reason(error.to_string())),
        eframe::Error::Winit(error) => ViewerError::NoDisplay(reason(error.to_string())),
        eframe::Error::Wgpu(error) => ViewerError::NoDisplay(error.to_string()),
        error => ViewerError::Failed(error.to_string()),
    }
}
