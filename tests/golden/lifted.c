/* x_next = Phi(x, u, p): 2 Ralston step(s) over dt; S = d x_next / d(x, u)
 *   x [2]
 *   u [2]
 *   p [2]
 *   dt [1]
 *   x_next [2]
 *   S [2 x 4]
 * 131 add, 139 mul, 22 div, 4 call, 4 other */
static void integrator_interval(const real *x, const real *u, const real *p, const real *dt, real *x_next, real *S)
{
    const real x_0 = x[0];
    const real dt_0 = dt[0];
    const real u_0 = u[0];
    const real p_0 = p[0];
    const real p_1 = p[1];
    const real x_1 = x[1];
    const real u_1 = u[1];
    const real t4 = dt_0 / 2.0;
    const real t5 = 0.25 * t4;
    const real t8 = 1.0 - x_0;
    const real t9 = u_0 * t8;
    const real t11 = x_0 * p_0;
    const real t14 = p_1 / x_1;
    const real t15 = -t14;
    const real t16 = exp(t15);
    const real t17 = t11 * t16;
    const real t18 = t9 - t17;
    const real t19 = t5 * t18;
    const real t20 = x_0 + t19;
    const real t22 = t4 * 0.75;
    const real t24 = t4 * 0.6666666666666666;
    const real t25 = t18 * t24;
    const real t26 = x_0 + t25;
    const real t27 = 1.0 - t26;
    const real t28 = u_0 * t27;
    const real t29 = p_0 * t26;
    const real t30 = 1.0 - x_1;
    const real t31 = u_0 * t30;
    const real t32 = t17 + t17;
    const real t33 = t31 + t32;
    const real t36 = x_1 - 0.5;
    const real t37 = u_1 * t36;
    const real t38 = 1.0 + u_1;
    const real t39 = t37 / t38;
    const real t40 = t33 - t39;
    const real t41 = t24 * t40;
    const real t42 = x_1 + t41;
    const real t43 = p_1 / t42;
    const real t44 = -t43;
    const real t45 = exp(t44);
    const real t46 = t29 * t45;
    const real t47 = t28 - t46;
    const real t48 = t22 * t47;
    const real t49 = t20 + t48;
    const real t50 = 1.0 - t49;
    const real t51 = u_0 * t50;
    const real t52 = p_0 * t49;
    const real t53 = t5 * t40;
    const real t54 = x_1 + t53;
    const real t55 = 1.0 - t42;
    const real t56 = u_0 * t55;
    const real t57 = t46 + t46;
    const real t58 = t56 + t57;
    const real t59 = t42 - 0.5;
    const real t60 = u_1 * t59;
    const real t61 = t60 / t38;
    const real t62 = t58 - t61;
    const real t63 = t22 * t62;
    const real t64 = t54 + t63;
    const real t65 = p_1 / t64;
    const real t66 = -t65;
    const real t67 = exp(t66);
    const real t68 = t52 * t67;
    const real t69 = t51 - t68;
    const real t70 = t5 * t69;
    const real t71 = t49 + t70;
    const real t72 = t24 * t69;
    const real t73 = t49 + t72;
    const real t74 = 1.0 - t73;
    const real t75 = u_0 * t74;
    const real t76 = p_0 * t73;
    const real t77 = 1.0 - t64;
    const real t78 = u_0 * t77;
    const real t79 = t68 + t68;
    const real t80 = t78 + t79;
    const real t81 = t64 - 0.5;
    const real t82 = u_1 * t81;
    const real t83 = t82 / t38;
    const real t84 = t80 - t83;
    const real t85 = t24 * t84;
    const real t86 = t64 + t85;
    const real t87 = p_1 / t86;
    const real t88 = -t87;
    const real t89 = exp(t88);
    const real t90 = t76 * t89;
    const real t91 = t75 - t90;
    const real t92 = t22 * t91;
    const real t93 = t71 + t92;
    const real t94 = t5 * t84;
    const real t95 = t64 + t94;
    const real t96 = 1.0 - t86;
    const real t97 = u_0 * t96;
    const real t98 = t90 + t90;
    const real t99 = t97 + t98;
    const real t100 = t86 - 0.5;
    const real t101 = u_1 * t100;
    const real t102 = t101 / t38;
    const real t103 = t99 - t102;
    const real t104 = t22 * t103;
    const real t105 = t95 + t104;
    const real t106 = p_0 * t16;
    const real t107 = u_0 + t106;
    const real t108 = t5 * t107;
    const real t109 = 1.0 - t108;
    const real t110 = p_0 * t45;
    const real t111 = u_0 + t110;
    const real t112 = t24 * t107;
    const real t113 = 1.0 - t112;
    const real t114 = t111 * t113;
    const real t115 = t43 / t42;
    const real t116 = t45 * t115;
    const real t117 = t29 * t116;
    const real t118 = t106 + t106;
    const real t119 = t24 * t118;
    const real t120 = t117 * t119;
    const real t121 = t114 + t120;
    const real t122 = t22 * t121;
    const real t123 = t109 - t122;
    const real t124 = p_0 * t67;
    const real t125 = u_0 + t124;
    const real t126 = t123 * t125;
    const real t127 = t65 / t64;
    const real t128 = t67 * t127;
    const real t129 = t52 * t128;
    const real t130 = t5 * t118;
    const real t131 = t110 + t110;
    const real t132 = t113 * t131;
    const real t133 = t117 + t117;
    const real t134 = t133 - u_0;
    const real t135 = u_1 / t38;
    const real t136 = t134 - t135;
    const real t137 = t119 * t136;
    const real t138 = t132 + t137;
    const real t139 = t22 * t138;
    const real t140 = t130 + t139;
    const real t141 = t129 * t140;
    const real t142 = t126 + t141;
    const real t143 = t5 * t142;
    const real t144 = t123 - t143;
    const real t145 = p_0 * t89;
    const real t146 = u_0 + t145;
    const real t147 = t24 * t142;
    const real t148 = t123 - t147;
    const real t149 = t146 * t148;
    const real t150 = t87 / t86;
    const real t151 = t89 * t150;
    const real t152 = t76 * t151;
    const real t153 = t124 + t124;
    const real t154 = t123 * t153;
    const real t155 = t129 + t129;
    const real t156 = t155 - u_0;
    const real t157 = t156 - t135;
    const real t158 = t140 * t157;
    const real t159 = t154 + t158;
    const real t160 = t24 * t159;
    const real t161 = t140 + t160;
    const real t162 = t152 * t161;
    const real t163 = t149 + t162;
    const real t164 = t22 * t163;
    const real t165 = t144 - t164;
    const real t166 = t5 * t159;
    const real t167 = t140 + t166;
    const real t168 = t145 + t145;
    const real t169 = t148 * t168;
    const real t170 = t152 + t152;
    const real t171 = t170 - u_0;
    const real t172 = t171 - t135;
    const real t173 = t161 * t172;
    const real t174 = t169 + t173;
    const real t175 = t22 * t174;
    const real t176 = t167 + t175;
    const real t177 = t14 / x_1;
    const real t178 = t16 * t177;
    const real t179 = t11 * t178;
    const real t180 = t24 * t179;
    const real t181 = t111 * t180;
    const real t182 = t179 + t179;
    const real t183 = t182 - u_0;
    const real t184 = t183 - t135;
    const real t185 = t24 * t184;
    const real t186 = 1.0 + t185;
    const real t187 = t117 * t186;
    const real t188 = t181 - t187;
    const real t189 = t22 * t188;
    const real t190 = t5 * t179;
    const real t191 = t189 - t190;
    const real t192 = t125 * t191;
    const real t193 = t5 * t184;
    const real t194 = 1.0 + t193;
    const real t195 = t136 * t186;
    const real t196 = t131 * t180;
    const real t197 = t195 - t196;
    const real t198 = t22 * t197;
    const real t199 = t194 + t198;
    const real t200 = t129 * t199;
    const real t201 = t192 + t200;
    const real t202 = t5 * t201;
    const real t203 = t191 - t202;
    const real t204 = t24 * t201;
    const real t205 = t191 - t204;
    const real t206 = t146 * t205;
    const real t207 = t153 * t191;
    const real t208 = t157 * t199;
    const real t209 = t207 + t208;
    const real t210 = t24 * t209;
    const real t211 = t199 + t210;
    const real t212 = t152 * t211;
    const real t213 = t206 + t212;
    const real t214 = t22 * t213;
    const real t215 = t203 - t214;
    const real t216 = t5 * t209;
    const real t217 = t199 + t216;
    const real t218 = t168 * t205;
    const real t219 = t172 * t211;
    const real t220 = t218 + t219;
    const real t221 = t22 * t220;
    const real t222 = t217 + t221;
    const real t223 = t5 * t8;
    const real t224 = t8 * t24;
    const real t225 = t111 * t224;
    const real t226 = t24 * t30;
    const real t227 = t117 * t226;
    const real t228 = t225 + t227;
    const real t229 = t27 - t228;
    const real t230 = t22 * t229;
    const real t231 = t223 + t230;
    const real t232 = t125 * t231;
    const real t233 = t5 * t30;
    const real t234 = t131 * t224;
    const real t235 = t136 * t226;
    const real t236 = t234 + t235;
    const real t237 = t55 + t236;
    const real t238 = t22 * t237;
    const real t239 = t233 + t238;
    const real t240 = t129 * t239;
    const real t241 = t232 + t240;
    const real t242 = t50 - t241;
    const real t243 = t5 * t242;
    const real t244 = t231 + t243;
    const real t245 = t24 * t242;
    const real t246 = t231 + t245;
    const real t247 = t146 * t246;
    const real t248 = t153 * t231;
    const real t249 = t157 * t239;
    const real t250 = t248 + t249;
    const real t251 = t77 + t250;
    const real t252 = t24 * t251;
    const real t253 = t239 + t252;
    const real t254 = t152 * t253;
    const real t255 = t247 + t254;
    const real t256 = t74 - t255;
    const real t257 = t22 * t256;
    const real t258 = t244 + t257;
    const real t259 = t5 * t251;
    const real t260 = t239 + t259;
    const real t261 = t168 * t246;
    const real t262 = t172 * t253;
    const real t263 = t261 + t262;
    const real t264 = t96 + t263;
    const real t265 = t22 * t264;
    const real t266 = t260 + t265;
    const real t267 = t36 / t38;
    const real t268 = t39 / t38;
    const real t269 = t267 - t268;
    const real t270 = t24 * t269;
    const real t271 = t117 * t270;
    const real t272 = t22 * t271;
    const real t273 = t5 * t269;
    const real t274 = t136 * t270;
    const real t275 = t59 / t38;
    const real t276 = t61 / t38;
    const real t277 = t275 - t276;
    const real t278 = t274 + t277;
    const real t279 = t22 * t278;
    const real t280 = t273 + t279;
    const real t281 = t129 * t280;
    const real t282 = t125 * t272;
    const real t283 = t281 - t282;
    const real t284 = t5 * t283;
    const real t285 = t272 + t284;
    const real t286 = t24 * t283;
    const real t287 = t272 + t286;
    const real t288 = t146 * t287;
    const real t289 = t153 * t272;
    const real t290 = t157 * t280;
    const real t291 = t289 - t290;
    const real t292 = t81 / t38;
    const real t293 = t83 / t38;
    const real t294 = t292 - t293;
    const real t295 = t291 - t294;
    const real t296 = t24 * t295;
    const real t297 = t296 - t280;
    const real t298 = t152 * t297;
    const real t299 = t288 + t298;
    const real t300 = t22 * t299;
    const real t301 = t285 - t300;
    const real t302 = t5 * t295;
    const real t303 = t302 - t280;
    const real t304 = t168 * t287;
    const real t305 = t172 * t297;
    const real t306 = t304 + t305;
    const real t307 = t100 / t38;
    const real t308 = t102 / t38;
    const real t309 = t307 - t308;
    const real t310 = t306 - t309;
    const real t311 = t22 * t310;
    const real t312 = t303 + t311;
    x_next[0] = t93;
    x_next[1] = t105;
    S[0] = t165;
    S[4] = t176;
    S[1] = t215;
    S[5] = t222;
    S[2] = t258;
    S[6] = t266;
    S[3] = t301;
    S[7] = t312;
}

/* integrator_interval: step_length
 *   dt [1]
 *   h [1]
 * 1 div */
static void integrator_interval_step_length(const real *dt, real *h)
{
    const real dt_0 = dt[0];
    const real t2 = dt_0 / 2.0;
    h[0] = t2;
}

/* integrator_interval: copy_x
 *   x [2]
 *   y [2]
 * no operations */
static void integrator_interval_copy_x(const real *x, real *y)
{
    const real x_0 = x[0];
    const real x_1 = x[1];
    y[0] = x_0;
    y[1] = x_1;
}

/* integrator_interval: identity
 *   s [8]
 * no operations */
static void integrator_interval_identity(real *s)
{
    s[0] = 1.0;
    s[1] = 0.0;
    s[2] = 0.0;
    s[3] = 0.0;
    s[4] = 0.0;
    s[5] = 1.0;
    s[6] = 0.0;
    s[7] = 0.0;
}

/* integrator_interval: linearize_f
 *   x [2]
 *   u [2]
 *   p [2]
 *   K [2]
 *   fx [4]
 *   Fu [8]
 * 14 add, 8 mul, 6 div, 1 call, 4 other */
static void integrator_interval_linearize_f(const real *x, const real *u, const real *p, real *K, real *fx, real *Fu)
{
    const real u_0 = u[0];
    const real x_0 = x[0];
    const real p_0 = p[0];
    const real p_1 = p[1];
    const real x_1 = x[1];
    const real u_1 = u[1];
    const real t3 = 1.0 - x_0;
    const real t4 = u_0 * t3;
    const real t6 = x_0 * p_0;
    const real t9 = p_1 / x_1;
    const real t10 = -t9;
    const real t11 = exp(t10);
    const real t12 = t6 * t11;
    const real t13 = t4 - t12;
    const real t14 = 1.0 - x_1;
    const real t15 = u_0 * t14;
    const real t16 = t12 + t12;
    const real t17 = t15 + t16;
    const real t20 = x_1 - 0.5;
    const real t21 = u_1 * t20;
    const real t22 = 1.0 + u_1;
    const real t23 = t21 / t22;
    const real t24 = t17 - t23;
    const real t25 = p_0 * t11;
    const real t26 = u_0 + t25;
    const real t27 = -t26;
    const real t28 = t25 + t25;
    const real t29 = t9 / x_1;
    const real t30 = t11 * t29;
    const real t31 = t6 * t30;
    const real t32 = -t31;
    const real t33 = t31 + t31;
    const real t34 = t33 - u_0;
    const real t35 = u_1 / t22;
    const real t36 = t34 - t35;
    const real t38 = t20 / t22;
    const real t39 = t23 / t22;
    const real t40 = t38 - t39;
    const real t41 = -t40;
    K[0] = t13;
    K[1] = t24;
    fx[0] = t27;
    fx[1] = t28;
    fx[2] = t32;
    fx[3] = t36;
    Fu[0] = 0.0;
    Fu[1] = 0.0;
    Fu[2] = t3;
    Fu[3] = 0.0;
    Fu[4] = 0.0;
    Fu[5] = 0.0;
    Fu[6] = t14;
    Fu[7] = t41;
}

/* integrator_interval: stage_1
 *   x [2]
 *   h [1]
 *   K0 [2]
 *   y [2]
 * 2 add, 3 mul */
static void integrator_interval_stage_1(const real *x, const real *h, const real *K0, real *y)
{
    const real x_0 = x[0];
    const real h_0 = h[0];
    const real K0_0 = K0[0];
    const real x_1 = x[1];
    const real K0_1 = K0[1];
    const real t3 = 0.6666666666666666 * h_0;
    const real t5 = t3 * K0_0;
    const real t6 = x_0 + t5;
    const real t9 = t3 * K0_1;
    const real t10 = x_1 + t9;
    y[0] = t6;
    y[1] = t10;
}

/* integrator_interval: update
 *   x [2]
 *   h [1]
 *   K0 [2]
 *   K1 [2]
 *   y [2]
 * 4 add, 6 mul */
static void integrator_interval_update(const real *x, const real *h, const real *K0, const real *K1, real *y)
{
    const real x_0 = x[0];
    const real h_0 = h[0];
    const real K0_0 = K0[0];
    const real K1_0 = K1[0];
    const real x_1 = x[1];
    const real K0_1 = K0[1];
    const real K1_1 = K1[1];
    const real t3 = 0.25 * h_0;
    const real t5 = t3 * K0_0;
    const real t6 = x_0 + t5;
    const real t8 = h_0 * 0.75;
    const real t10 = t8 * K1_0;
    const real t11 = t6 + t10;
    const real t14 = t3 * K0_1;
    const real t15 = x_1 + t14;
    const real t17 = t8 * K1_1;
    const real t18 = t15 + t17;
    y[0] = t11;
    y[1] = t18;
}

/* integrator_interval: copy_row
 *   x [4]
 *   y [4]
 * no operations */
static void integrator_interval_copy_row(const real *x, real *y)
{
    const real x_0 = x[0];
    const real x_1 = x[1];
    const real x_2 = x[2];
    const real x_3 = x[3];
    y[0] = x_0;
    y[1] = x_1;
    y[2] = x_2;
    y[3] = x_3;
}

/* x_next = Phi(x, u, p): 2 Ralston step(s) over dt; S = d x_next / d(x, u)
 *   x [2]
 *   u [2]
 *   p [2]
 *   dt [1]
 *   x_next [2]
 *   S [2 x 4]
 * 180 add, 186 mul, 25 div, 4 call, 16 other */
static void integrator_interval(const real *x, const real *u, const real *p, const real *dt, real *x_next, real *S)
{
    real h[1];
    real X[2];
    real Sx[8];
    real Xi[2];
    real K[4];
    real Ks[16];
    real fx[4];
    real Fu[8];
    int step, c, i;
    integrator_interval_step_length(&dt[0], &h[0]);
    integrator_interval_copy_x(&x[0], &X[0]);
    integrator_interval_identity(&Sx[0]);
    for (step = 0; step < 2; step++) {
        integrator_interval_linearize_f(&X[0], &u[0], &p[0], &K[0], &fx[0], &Fu[0]);
        for (c = 0; c < 4; c++) {
            const real fx_0 = fx[0];
            const real s_0 = Sx[c];
            const real fx_2 = fx[2];
            const real s_1 = Sx[c + 4];
            const real Fu_0 = Fu[c];
            const real fx_1 = fx[1];
            const real fx_3 = fx[3];
            const real Fu_1 = Fu[c + 4];
            const real t2 = fx_0 * s_0;
            const real t5 = fx_2 * s_1;
            const real t6 = t2 + t5;
            const real t8 = t6 + Fu_0;
            const real t10 = s_0 * fx_1;
            const real t12 = s_1 * fx_3;
            const real t13 = t10 + t12;
            const real t15 = t13 + Fu_1;
            Ks[c] = t8;
            Ks[c + 4] = t15;
        }
        integrator_interval_stage_1(&X[0], &h[0], &K[0], &Xi[0]);
        integrator_interval_linearize_f(&Xi[0], &u[0], &p[0], &K[2], &fx[0], &Fu[0]);
        for (c = 0; c < 4; c++) {
            const real fx_0 = fx[0];
            const real s_0 = Sx[c];
            const real h_0 = h[0];
            const real K0_0 = Ks[c];
            const real fx_2 = fx[2];
            const real s_1 = Sx[c + 4];
            const real K0_1 = Ks[c + 4];
            const real Fu_0 = Fu[c];
            const real fx_1 = fx[1];
            const real fx_3 = fx[3];
            const real Fu_1 = Fu[c + 4];
            const real t4 = 0.6666666666666666 * h_0;
            const real t6 = t4 * K0_0;
            const real t7 = s_0 + t6;
            const real t8 = fx_0 * t7;
            const real t12 = t4 * K0_1;
            const real t13 = s_1 + t12;
            const real t14 = fx_2 * t13;
            const real t15 = t8 + t14;
            const real t17 = t15 + Fu_0;
            const real t19 = t7 * fx_1;
            const real t21 = t13 * fx_3;
            const real t22 = t19 + t21;
            const real t24 = t22 + Fu_1;
            Ks[c + 8] = t17;
            Ks[c + 12] = t24;
        }
        integrator_interval_update(&X[0], &h[0], &K[0], &K[2], &X[0]);
        for (c = 0; c < 4; c++) {
            const real x_0 = Sx[c];
            const real h_0 = h[0];
            const real K0_0 = Ks[c];
            const real K1_0 = Ks[c + 8];
            const real x_1 = Sx[c + 4];
            const real K0_1 = Ks[c + 4];
            const real K1_1 = Ks[c + 12];
            const real t3 = 0.25 * h_0;
            const real t5 = t3 * K0_0;
            const real t6 = x_0 + t5;
            const real t8 = h_0 * 0.75;
            const real t10 = t8 * K1_0;
            const real t11 = t6 + t10;
            const real t14 = t3 * K0_1;
            const real t15 = x_1 + t14;
            const real t17 = t8 * K1_1;
            const real t18 = t15 + t17;
            Sx[c] = t11;
            Sx[c + 4] = t18;
        }
    }
    integrator_interval_copy_x(&X[0], &x_next[0]);
    for (i = 0; i < 2; i++) {
        integrator_interval_copy_row(&Sx[4 * i], &S[4 * i]);
    }
}
