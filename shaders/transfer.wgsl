// Basis coefficients from the direct vector: u = M x, or M x^(1/γ) (METHOD eq. 7). One workgroup a coefficient.
// CPU twin: Transfer::coefficients.
struct TransferShape {
    points: u32,
    interleaved: u32,          // 1: the channels of x are one vector (multi); 0: each is its own (mono)
    mean_scaled_by_norm: u32,  // 1: coefficient 0 is the norm of x
    inverse_gamma: f32,        // x is raised to this first
    scale: f32,                // what the matrix is multiplied with
}

@group(0) @binding(0) var<uniform> shape: TransferShape;
@group(0) @binding(1) var<storage, read> matrix: array<u32>;              // [element][channel][pair of points], two halves a word
@group(0) @binding(2) var<storage, read> direct: array<vec4f>;            // W/m², one a point
@group(0) @binding(3) var<storage, read_write> coefficients: array<vec4f>;

const LANES = 64u;
var<workgroup> partial: array<vec3f, LANES>;

// x of a point, or its root.
fn measured(point: u32) -> vec3f {
    let x = direct[point].rgb;
    if shape.inverse_gamma == 1.0 {
        return x;
    }
    return pow(max(x, vec3f(0.0)), vec3f(shape.inverse_gamma));
}

@compute @workgroup_size(LANES)
fn transfer(@builtin(workgroup_id) workgroup: vec3u, @builtin(local_invocation_index) lane: u32) {
    let element = workgroup.x;
    let norm = element == 0u && shape.mean_scaled_by_norm == 1u;
    let pairs = (shape.points + 1u) / 2u;
    var sum = vec3f(0.0);
    for (var pair = lane; pair < pairs; pair += LANES) {
        let at = 3u * element * pairs + pair;
        let red = unpack2x16float(matrix[at]);
        let green = unpack2x16float(matrix[at + pairs]);
        let blue = unpack2x16float(matrix[at + 2u * pairs]);
        for (var i = 0u; i < 2u; i++) {
            let point = 2u * pair + i;
            if point < shape.points {
                let x = measured(point);
                sum += x * select(vec3f(red[i], green[i], blue[i]), x, norm);
            }
        }
    }
    partial[lane] = sum;
    for (var half_count = LANES / 2u; half_count > 0u; half_count /= 2u) {
        workgroupBarrier();
        if lane < half_count {
            partial[lane] += partial[lane + half_count];
        }
    }
    if lane == 0u {
        var u = partial[0];
        if shape.interleaved == 1u {
            u = vec3f(u.r + u.g + u.b);
        }
        coefficients[element] = vec4f(select(u * shape.scale, sqrt(u), norm), 0.0);
    }
}
