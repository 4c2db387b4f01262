#version 330
// Marschner et al. 2003 in its separable form: a Gaussian lobe along the strand (theta) times a simple lobe around it
// (phi), for the uncoloured reflection R and the coloured one TRT, over a Kajiya-Kay diffuse term. Linear light.
in vec3 world;
in vec3 tangent;
in float along;
in float across;
in float variation;
uniform vec3 hair_colour;
uniform vec3 fill_direction;
uniform vec3 rim_direction;
out vec4 colour;

#include "key_shadow.glsl"

float lobe(float x, float width) { return exp(-0.5 * x * x / (width * width)); }

vec3 scattered(vec3 t, vec3 view, vec3 light, vec3 albedo) {
    float sin_in = dot(t, light), sin_out = dot(t, view);
    float half_theta = 0.5 * (asin(clamp(sin_in, -1.0, 1.0)) + asin(clamp(sin_out, -1.0, 1.0)));
    vec3 light_across = light - sin_in * t, view_across = view - sin_out * t;
    float cos_phi = dot(light_across, view_across) / max(length(light_across) * length(view_across), 1e-4);
    float facing = sqrt(0.5 + 0.5 * clamp(cos_phi, -1.0, 1.0));
    float shift = radians(6.0) + radians(4.0) * (variation - 0.5);
    // Cuticle scales tilt towards the root: R moves to one side of the mirror direction, TRT to the other.
    float r = lobe(half_theta + shift, radians(6.0)) * facing;
    float trt = lobe(half_theta - 1.5 * shift, radians(11.0)) * facing * facing;
    float diffuse = sqrt(max(1.0 - sin_in * sin_in, 0.0)) * (0.35 + 0.65 * facing);
    return 0.8 * albedo * diffuse + vec3(0.07) * r + 1.6 * albedo * trt;
}

void main() {
    vec3 t = normalize(tangent), view = normalize(eye - world);
    vec3 albedo = hair_colour * (0.6 + 0.8 * variation * variation) * mix(0.8, 1.1, along);
    float thickness = thickness_in_hair(world);
    float transmission = exp(-thickness) * body_visibility(world, 0.004, 1);
    // Little ambient light reaches strands deep inside, and least of all the roots.
    float openness = mix(0.3, 1.0, exp(-0.4 * thickness)) * mix(0.55, 1.0, smoothstep(0.0, 0.3, along));
    vec3 light = 1.25 * transmission * scattered(t, view, key_direction, albedo);
    light += openness * vec3(0.29, 0.29, 0.30) * scattered(t, view, fill_direction, albedo);
    light += openness * 0.30 * scattered(t, view, rim_direction, albedo);
    light += openness * 0.10 * albedo;
    light *= 1.0 - 0.35 * across * across;
    colour = vec4(display(light), 1.0);
}
