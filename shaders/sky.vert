// One triangle that covers the picture at infinite distance (depth 0).
#version 450
layout(location = 0) out vec2 at;

void main() {
  at = vec2(gl_VertexIndex == 1 ? 3 : -1, gl_VertexIndex == 2 ? 3 : -1);
  gl_Position = vec4(at, 0, 1);
}
