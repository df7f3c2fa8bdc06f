/** Eye-dome lighting: what lies behind its neighbours is darkened, which gives clouds their shape
 * (Boucheny 2009). Drawn over the finished picture, from its depths alone. */

import {
  DepthTexture,
  GLSL3,
  Mesh,
  NearestFilter,
  OrthographicCamera,
  type PerspectiveCamera,
  PlaneGeometry,
  ShaderMaterial,
  UnsignedIntType,
  Vector2,
  type WebGLRenderer,
  WebGLRenderTarget,
} from "three";

const VERTEX = `
out vec2 at;
void main() {
  at = uv;
  gl_Position = vec4(position.xy, 0.0, 1.0);
}`;

const FRAGMENT = `
in vec2 at;
uniform sampler2D picture, depths;
uniform vec2 pixel;
uniform float near, far, strength;
out vec4 color;
float log_depth(float depth) {
  return log2(near * far / (far - depth * (far - near)));
}
void main() {
  color = texture(picture, at);
  float depth = texture(depths, at).r;
  if (depth >= 1.0) return;
  float own = log_depth(depth);
  float behind = 0.0;
  // in pairs on opposite sides: a slope alone is no relief
  for (int i = 0; i < 4; i++) {
    float angle = 0.7854 * float(i);
    vec2 way = pixel * vec2(cos(angle), sin(angle));
    float ahead = clamp(log_depth(texture(depths, at + way).r), own - 0.05, own + 0.05);
    float back = clamp(log_depth(texture(depths, at - way).r), own - 0.05, own + 0.05);
    behind += max(0.0, 2.0 * own - ahead - back);
  }
  color.rgb *= mix(0.42, 1.0, exp(-strength * behind / 4.0));
}`;

export class Relief {
  readonly target: WebGLRenderTarget;
  private readonly quad: Mesh<PlaneGeometry, ShaderMaterial>;
  private readonly camera = new OrthographicCamera(-1, 1, 1, -1, 0, 1);

  constructor() {
    this.target = new WebGLRenderTarget(1, 1, { samples: 4 });
    this.target.depthTexture = new DepthTexture(1, 1, UnsignedIntType);
    this.target.depthTexture.minFilter = NearestFilter;
    this.target.depthTexture.magFilter = NearestFilter;
    const material = new ShaderMaterial({
      glslVersion: GLSL3,
      vertexShader: VERTEX,
      fragmentShader: FRAGMENT,
      depthTest: false,
      depthWrite: false,
      uniforms: {
        picture: { value: this.target.texture },
        depths: { value: this.target.depthTexture },
        pixel: { value: new Vector2() },
        near: { value: 0.1 },
        far: { value: 10 },
        strength: { value: 22 },
      },
    });
    this.quad = new Mesh(new PlaneGeometry(2, 2), material);
    this.quad.frustumCulled = false;
  }

  setSize(width: number, height: number, ratio: number): void {
    this.target.setSize(width, height);
    this.quad.material.uniforms.pixel.value.set((1.3 * ratio) / width, (1.3 * ratio) / height);
  }

  /** Draws the target onto the canvas. */
  draw(renderer: WebGLRenderer, camera: PerspectiveCamera): void {
    const { uniforms } = this.quad.material;
    uniforms.near.value = camera.near;
    uniforms.far.value = camera.far;
    renderer.setRenderTarget(null);
    renderer.render(this.quad, this.camera);
  }

  dispose(): void {
    this.target.depthTexture?.dispose();
    this.target.dispose();
    this.quad.geometry.dispose();
    this.quad.material.dispose();
  }
}
