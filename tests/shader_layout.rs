//! The structs that Rust writes and WGSL reads have the same fields at the same offsets.

use std::collections::BTreeMap;
use std::mem::offset_of;

use naga::TypeInner;
use relight::gpu::Lookup;
use relight::gpu::shader::Stage;
use relight::gpu::{
    Blocker, FrameUniforms, GpuLight, GpuMaterial, Node, SubPoint, TextureUse, TransferShape, Triangle, Vertex,
};
use relight::model::{Basis, Values};

/// Offset of each field, and the stride of the struct in an array.
#[derive(Debug, PartialEq)]
struct Layout {
    offsets: BTreeMap<String, u32>,
    stride: u32,
}

macro_rules! layout_of {
    ($rust:ty { $($field:ident),* $(,)? }) => {
        Layout {
            offsets: [$((stringify!($field).to_owned(), offset_of!($rust, $field) as u32)),*].into(),
            stride: size_of::<$rust>() as u32,
        }
    };
}

/// The layouts of all structs of all stages, by name.
fn wgsl_layouts() -> BTreeMap<String, Layout> {
    let mut layouts = BTreeMap::new();
    let basis = Basis { size: 1, elements: 1, components: 1, values: Values::Byte(vec![0]), anchors: None, gamma: 1.0 };
    for stage in Stage::ALL {
        let source = stage.source(&basis, Lookup::Texture);
        let module = naga::front::wgsl::parse_str(&source)
            .unwrap_or_else(|e| panic!("{}: {}", stage.name(), e.emit_to_string(&source)));
        let mut layouter = naga::proc::Layouter::default();
        layouter.update(module.to_ctx()).expect("a parsed module has sizes");
        for (handle, ty) in module.types.iter() {
            if let (Some(name), TypeInner::Struct { members, .. }) = (&ty.name, &ty.inner) {
                let offsets = members.iter().map(|m| (m.name.clone().expect("fields have names"), m.offset)).collect();
                layouts.insert(name.clone(), Layout { offsets, stride: layouter[handle].to_stride() });
            }
        }
    }
    layouts
}

#[test]
fn rust_and_wgsl_structs_agree() {
    let wgsl = wgsl_layouts();
    let rust = [
        (
            "Frame",
            layout_of!(FrameUniforms {
                clip_from_world,
                eye_ws,
                shadow_offset,
                extent,
                light_count,
                shown,
                samples_per_axis,
            }),
        ),
        (
            "Light",
            layout_of!(GpuLight { position, local, direction, inverse_range4, radiant, cone_scale, cone_offset, lobe }),
        ),
        ("Vertex", layout_of!(Vertex { position, normal, colour, uv0, uv1, lightmap_uv })),
        ("Triangle", layout_of!(Triangle { vertices, material })),
        ("TextureUse", layout_of!(TextureUse { u_from_uv, page, v_from_uv, uv_set, origin, size, wrap, srgb })),
        (
            "Material",
            layout_of!(GpuMaterial {
                base_colour,
                emissive,
                metallic,
                roughness,
                alpha_cutoff,
                metallic_roughness,
                base_colour_texture,
                metallic_roughness_texture,
                emissive_texture,
            }),
        ),
        ("Node", layout_of!(Node { low, after, high, primitives })),
        ("Blocker", layout_of!(Blocker { a, triangle, b, masked, c })),
        ("SubPoint", layout_of!(SubPoint { position, normal, geometric_normal, albedo })),
        ("TransferShape", layout_of!(TransferShape { points, interleaved, mean_scaled_by_norm, inverse_gamma, scale })),
    ];
    for (name, layout) in rust {
        assert_eq!(wgsl.get(name), Some(&layout), "struct {name}");
    }
}

/// The control: a struct whose fields are swapped is told apart.
#[test]
fn a_swapped_field_is_noticed() {
    #[repr(C)]
    struct Swapped {
        low: [f32; 3],
        primitives: u32,
        high: [f32; 3],
        after: u32,
    }
    assert_ne!(wgsl_layouts()["Node"], layout_of!(Swapped { low, primitives, high, after }));
}
