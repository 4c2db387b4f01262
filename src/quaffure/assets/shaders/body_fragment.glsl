#version 330
in vec3 world;
in vec3 surface_normal;
in float hair_cover;
uniform vec3 body_colour;
uniform vec3 hair_colour;
uniform vec3 fill_direction;
uniform vec3 rim_direction;
out vec4 colour;

#include "key_shadow.glsl"

// Red light travels further in skin and in hair: their shadows are warm.
const vec3 SKIN_SHADOW = vec3(0.75, 1.0, 1.15);

// Light wraps past the terminator on skin.
float wrapped(vec3 n, vec3 light) { float w = 0.25; return max((dot(n, light) + w) / (1.0 + w), 0.0); }

void main() {
    vec3 n = normalize(surface_normal), view = normalize(eye - world);
    if (!gl_FrontFacing) n = -n;
    vec3 transmission = exp(-SKIN_SHADOW * thickness_before_body(world, 0.012));
    transmission *= body_visibility(world + 0.006 * n, 0.003, 2);
    float sky = 0.5 + 0.5 * n.z;
    vec3 light = vec3(0.88, 0.85, 0.82) * wrapped(n, key_direction) * transmission;
    light += vec3(0.25, 0.25, 0.26) * wrapped(n, fill_direction);
    light += mix(vec3(0.11, 0.09, 0.08), vec3(0.23, 0.23, 0.235), sky);
    float grazing = pow(1.0 - max(dot(n, view), 0.0), 3.0);
    light += 0.35 * grazing * max(dot(n, rim_direction), 0.0);
    vec3 halfway = normalize(view + key_direction);
    float gloss = 0.06 * pow(max(dot(n, halfway), 0.0), 24.0) * transmission.g;
    // The guides stand for many more hairs between them, which hide most of the scalp.
    vec3 albedo = mix(body_colour, 0.45 * hair_colour, 0.9 * hair_cover);
    colour = vec4(display(albedo * light + gloss * (1.0 - hair_cover)), 1.0);
}
