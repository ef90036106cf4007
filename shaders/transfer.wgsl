// Basis coefficients from the direct vector: u = M x, or M x^(1/γ) (METHOD eq. 7). One workgroup a coefficient.
// CPU twin: Transfer::coefficients.
struct TransferShape {
    points: u32,
    interleaved: u32,          // 1: the channels of x are one vector (multi); 0: each is its own (mono)
    mean_scaled_by_norm: u32,  // 1: coefficient 0 is the norm of x
    inverse_gamma: f32,        // x is raised to this first
}

@group(0) @binding(0) var<uniform> shape: TransferShape;
@group(0) @binding(1) var<storage, read> matrix: array<f32>;              // [element][point][channel]
@group(0) @binding(2) var<storage, read> direct: array<vec4f>;            // W/m², one a point
@group(0) @binding(3) var<storage, read_write> coefficients: array<vec4f>;

const LANES = 64u;
var<workgroup> partial: array<vec3f, LANES>;

@compute @workgroup_size(LANES)
fn transfer(@builtin(workgroup_id) workgroup: vec3u, @builtin(local_invocation_index) lane: u32) {
    let element = workgroup.x;
    let norm = element == 0u && shape.mean_scaled_by_norm == 1u;
    var sum = vec3f(0.0);
    for (var point = lane; point < shape.points; point += LANES) {
        var x = direct[point].rgb;
        if shape.inverse_gamma != 1.0 {
            x = pow(max(x, vec3f(0.0)), vec3f(shape.inverse_gamma));
        }
        let at = 3u * (element * shape.points + point);
        sum += x * select(vec3f(matrix[at], matrix[at + 1u], matrix[at + 2u]), x, norm);
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
        coefficients[element] = vec4f(select(u, sqrt(u), norm), 0.0);
    }
}
