// Reads cameras as JSON from standard input, and writes three.js' matrices for them, row by row.

import * as THREE from "three";

const text = await new Promise((resolve) => {
    let all = "";
    process.stdin.on("data", (chunk) => (all += chunk)).on("end", () => resolve(all));
});

const rows = (matrix) => matrix.clone().transpose().elements; // three.js keeps columns

const found = JSON.parse(text).map((c) => {
    const perspective = new THREE.PerspectiveCamera(c.y_fov, c.aspect, c.near, c.far);
    perspective.up.set(...c.up);
    perspective.position.set(...c.eye);
    perspective.lookAt(...c.target);
    perspective.zoom = c.zoom;
    perspective.updateMatrixWorld();
    perspective.updateProjectionMatrix();

    const orthographic = new THREE.OrthographicCamera(
        c.left, c.right, c.top, c.bottom, c.near, c.far,
    );
    const thing = new THREE.Object3D();
    thing.up.set(...c.up);
    thing.position.set(...c.eye);
    thing.lookAt(...c.target);
    thing.updateMatrixWorld();

    const askew = new THREE.Matrix4().makePerspective(
        c.left, c.right, c.top, c.bottom, c.near, c.far,
    );
    return {
        perspective: rows(perspective.projectionMatrix),
        askew: rows(askew),
        orthographic: rows(orthographic.projectionMatrix),
        look_at: rows(perspective.matrix),
        inverse: rows(perspective.matrixWorldInverse),
        object_look_at: rows(thing.matrix),
        projected: new THREE.Vector3(...c.point).project(perspective).toArray(),
    };
});

process.stdout.write(JSON.stringify({ revision: THREE.REVISION, found }));
