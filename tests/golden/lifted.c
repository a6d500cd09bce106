/* x_next = Phi(x, u, p): 2 Ralston step(s) over dt; S = d x_next / d(x, u)
 *   x [2]
 *   u [2]
 *   p [2]
 *   dt [1]
 *   x_next [2]
 *   S [2 x 4]
 * 131 add, 161 mul, 5 div, 4 call, 4 other */
static void integrator_interval(const real *x, const real *u, const real *p, const real *dt, real *x_next, real *S)
{
    const real x_0 = x[0];
    const real dt_0 = dt[0];
    const real u_0 = u[0];
    const real p_0 = p[0];
    const real p_1 = p[1];
    const real x_1 = x[1];
    const real u_1 = u[1];
    const real t4 = dt_0 * 0.5;
    const real t5 = 0.25 * t4;
    const real t8 = 1.0 - x_0;
    const real t9 = u_0 * t8;
    const real t11 = x_0 * p_0;
    const real t14 = 1.0 / x_1;
    const real t15 = p_1 * t14;
    const real t16 = -t15;
    const real t17 = exp(t16);
    const real t18 = t11 * t17;
    const real t19 = t9 - t18;
    const real t20 = t5 * t19;
    const real t21 = x_0 + t20;
    const real t23 = t4 * 0.75;
    const real t25 = t4 * 0.6666666666666666;
    const real t26 = t19 * t25;
    const real t27 = x_0 + t26;
    const real t28 = 1.0 - t27;
    const real t29 = u_0 * t28;
    const real t30 = p_0 * t27;
    const real t31 = 1.0 - x_1;
    const real t32 = u_0 * t31;
    const real t33 = t18 + t18;
    const real t34 = t32 + t33;
    const real t36 = x_1 - 0.5;
    const real t37 = u_1 * t36;
    const real t38 = 1.0 + u_1;
    const real t39 = 1.0 / t38;
    const real t40 = t37 * t39;
    const real t41 = t34 - t40;
    const real t42 = t25 * t41;
    const real t43 = x_1 + t42;
    const real t44 = 1.0 / t43;
    const real t45 = p_1 * t44;
    const real t46 = -t45;
    const real t47 = exp(t46);
    const real t48 = t30 * t47;
    const real t49 = t29 - t48;
    const real t50 = t23 * t49;
    const real t51 = t21 + t50;
    const real t52 = 1.0 - t51;
    const real t53 = u_0 * t52;
    const real t54 = p_0 * t51;
    const real t55 = t5 * t41;
    const real t56 = x_1 + t55;
    const real t57 = 1.0 - t43;
    const real t58 = u_0 * t57;
    const real t59 = t48 + t48;
    const real t60 = t58 + t59;
    const real t61 = t43 - 0.5;
    const real t62 = u_1 * t61;
    const real t63 = t39 * t62;
    const real t64 = t60 - t63;
    const real t65 = t23 * t64;
    const real t66 = t56 + t65;
    const real t67 = 1.0 / t66;
    const real t68 = p_1 * t67;
    const real t69 = -t68;
    const real t70 = exp(t69);
    const real t71 = t54 * t70;
    const real t72 = t53 - t71;
    const real t73 = t5 * t72;
    const real t74 = t51 + t73;
    const real t75 = t25 * t72;
    const real t76 = t51 + t75;
    const real t77 = 1.0 - t76;
    const real t78 = u_0 * t77;
    const real t79 = p_0 * t76;
    const real t80 = 1.0 - t66;
    const real t81 = u_0 * t80;
    const real t82 = t71 + t71;
    const real t83 = t81 + t82;
    const real t84 = t66 - 0.5;
    const real t85 = u_1 * t84;
    const real t86 = t39 * t85;
    const real t87 = t83 - t86;
    const real t88 = t25 * t87;
    const real t89 = t66 + t88;
    const real t90 = 1.0 / t89;
    const real t91 = p_1 * t90;
    const real t92 = -t91;
    const real t93 = exp(t92);
    const real t94 = t79 * t93;
    const real t95 = t78 - t94;
    const real t96 = t23 * t95;
    const real t97 = t74 + t96;
    const real t98 = t5 * t87;
    const real t99 = t66 + t98;
    const real t100 = 1.0 - t89;
    const real t101 = u_0 * t100;
    const real t102 = t94 + t94;
    const real t103 = t101 + t102;
    const real t104 = t89 - 0.5;
    const real t105 = u_1 * t104;
    const real t106 = t39 * t105;
    const real t107 = t103 - t106;
    const real t108 = t23 * t107;
    const real t109 = t99 + t108;
    const real t110 = p_0 * t17;
    const real t111 = u_0 + t110;
    const real t112 = t5 * t111;
    const real t113 = 1.0 - t112;
    const real t114 = p_0 * t47;
    const real t115 = u_0 + t114;
    const real t116 = t25 * t111;
    const real t117 = 1.0 - t116;
    const real t118 = t115 * t117;
    const real t119 = t44 * t45;
    const real t120 = t47 * t119;
    const real t121 = t30 * t120;
    const real t122 = t110 + t110;
    const real t123 = t25 * t122;
    const real t124 = t121 * t123;
    const real t125 = t118 + t124;
    const real t126 = t23 * t125;
    const real t127 = t113 - t126;
    const real t128 = p_0 * t70;
    const real t129 = u_0 + t128;
    const real t130 = t127 * t129;
    const real t131 = t67 * t68;
    const real t132 = t70 * t131;
    const real t133 = t54 * t132;
    const real t134 = t5 * t122;
    const real t135 = t114 + t114;
    const real t136 = t117 * t135;
    const real t137 = t121 + t121;
    const real t138 = t137 - u_0;
    const real t139 = u_1 * t39;
    const real t140 = t138 - t139;
    const real t141 = t123 * t140;
    const real t142 = t136 + t141;
    const real t143 = t23 * t142;
    const real t144 = t134 + t143;
    const real t145 = t133 * t144;
    const real t146 = t130 + t145;
    const real t147 = t5 * t146;
    const real t148 = t127 - t147;
    const real t149 = p_0 * t93;
    const real t150 = u_0 + t149;
    const real t151 = t25 * t146;
    const real t152 = t127 - t151;
    const real t153 = t150 * t152;
    const real t154 = t90 * t91;
    const real t155 = t93 * t154;
    const real t156 = t79 * t155;
    const real t157 = t128 + t128;
    const real t158 = t127 * t157;
    const real t159 = t133 + t133;
    const real t160 = t159 - u_0;
    const real t161 = t160 - t139;
    const real t162 = t144 * t161;
    const real t163 = t158 + t162;
    const real t164 = t25 * t163;
    const real t165 = t144 + t164;
    const real t166 = t156 * t165;
    const real t167 = t153 + t166;
    const real t168 = t23 * t167;
    const real t169 = t148 - t168;
    const real t170 = t5 * t163;
    const real t171 = t144 + t170;
    const real t172 = t149 + t149;
    const real t173 = t152 * t172;
    const real t174 = t156 + t156;
    const real t175 = t174 - u_0;
    const real t176 = t175 - t139;
    const real t177 = t165 * t176;
    const real t178 = t173 + t177;
    const real t179 = t23 * t178;
    const real t180 = t171 + t179;
    const real t181 = t14 * t15;
    const real t182 = t17 * t181;
    const real t183 = t11 * t182;
    const real t184 = t25 * t183;
    const real t185 = t115 * t184;
    const real t186 = t183 + t183;
    const real t187 = t186 - u_0;
    const real t188 = t187 - t139;
    const real t189 = t25 * t188;
    const real t190 = 1.0 + t189;
    const real t191 = t121 * t190;
    const real t192 = t185 - t191;
    const real t193 = t23 * t192;
    const real t194 = t5 * t183;
    const real t195 = t193 - t194;
    const real t196 = t129 * t195;
    const real t197 = t5 * t188;
    const real t198 = 1.0 + t197;
    const real t199 = t140 * t190;
    const real t200 = t135 * t184;
    const real t201 = t199 - t200;
    const real t202 = t23 * t201;
    const real t203 = t198 + t202;
    const real t204 = t133 * t203;
    const real t205 = t196 + t204;
    const real t206 = t5 * t205;
    const real t207 = t195 - t206;
    const real t208 = t25 * t205;
    const real t209 = t195 - t208;
    const real t210 = t150 * t209;
    const real t211 = t157 * t195;
    const real t212 = t161 * t203;
    const real t213 = t211 + t212;
    const real t214 = t25 * t213;
    const real t215 = t203 + t214;
    const real t216 = t156 * t215;
    const real t217 = t210 + t216;
    const real t218 = t23 * t217;
    const real t219 = t207 - t218;
    const real t220 = t5 * t213;
    const real t221 = t203 + t220;
    const real t222 = t172 * t209;
    const real t223 = t176 * t215;
    const real t224 = t222 + t223;
    const real t225 = t23 * t224;
    const real t226 = t221 + t225;
    const real t227 = t5 * t8;
    const real t228 = t8 * t25;
    const real t229 = t115 * t228;
    const real t230 = t25 * t31;
    const real t231 = t121 * t230;
    const real t232 = t229 + t231;
    const real t233 = t28 - t232;
    const real t234 = t23 * t233;
    const real t235 = t227 + t234;
    const real t236 = t129 * t235;
    const real t237 = t5 * t31;
    const real t238 = t135 * t228;
    const real t239 = t140 * t230;
    const real t240 = t238 + t239;
    const real t241 = t57 + t240;
    const real t242 = t23 * t241;
    const real t243 = t237 + t242;
    const real t244 = t133 * t243;
    const real t245 = t236 + t244;
    const real t246 = t52 - t245;
    const real t247 = t5 * t246;
    const real t248 = t235 + t247;
    const real t249 = t25 * t246;
    const real t250 = t235 + t249;
    const real t251 = t150 * t250;
    const real t252 = t157 * t235;
    const real t253 = t161 * t243;
    const real t254 = t252 + t253;
    const real t255 = t80 + t254;
    const real t256 = t25 * t255;
    const real t257 = t243 + t256;
    const real t258 = t156 * t257;
    const real t259 = t251 + t258;
    const real t260 = t77 - t259;
    const real t261 = t23 * t260;
    const real t262 = t248 + t261;
    const real t263 = t5 * t255;
    const real t264 = t243 + t263;
    const real t265 = t172 * t250;
    const real t266 = t176 * t257;
    const real t267 = t265 + t266;
    const real t268 = t100 + t267;
    const real t269 = t23 * t268;
    const real t270 = t264 + t269;
    const real t271 = t36 * t39;
    const real t272 = t39 * t40;
    const real t273 = t271 - t272;
    const real t274 = t25 * t273;
    const real t275 = t121 * t274;
    const real t276 = t23 * t275;
    const real t277 = t5 * t273;
    const real t278 = t140 * t274;
    const real t279 = t39 * t61;
    const real t280 = t39 * t63;
    const real t281 = t279 - t280;
    const real t282 = t278 + t281;
    const real t283 = t23 * t282;
    const real t284 = t277 + t283;
    const real t285 = t133 * t284;
    const real t286 = t129 * t276;
    const real t287 = t285 - t286;
    const real t288 = t5 * t287;
    const real t289 = t276 + t288;
    const real t290 = t25 * t287;
    const real t291 = t276 + t290;
    const real t292 = t150 * t291;
    const real t293 = t157 * t276;
    const real t294 = t161 * t284;
    const real t295 = t293 - t294;
    const real t296 = t39 * t84;
    const real t297 = t39 * t86;
    const real t298 = t296 - t297;
    const real t299 = t295 - t298;
    const real t300 = t25 * t299;
    const real t301 = t300 - t284;
    const real t302 = t156 * t301;
    const real t303 = t292 + t302;
    const real t304 = t23 * t303;
    const real t305 = t289 - t304;
    const real t306 = t5 * t299;
    const real t307 = t306 - t284;
    const real t308 = t172 * t291;
    const real t309 = t176 * t301;
    const real t310 = t308 + t309;
    const real t311 = t39 * t104;
    const real t312 = t39 * t106;
    const real t313 = t311 - t312;
    const real t314 = t310 - t313;
    const real t315 = t23 * t314;
    const real t316 = t307 + t315;
    x_next[0] = t97;
    x_next[1] = t109;
    S[0] = t169;
    S[4] = t180;
    S[1] = t219;
    S[5] = t226;
    S[2] = t262;
    S[6] = t270;
    S[3] = t305;
    S[7] = t316;
}

/* integrator_interval: step_length
 *   dt [1]
 *   h [1]
 * 1 mul */
static void integrator_interval_step_length(const real *dt, real *h)
{
    const real dt_0 = dt[0];
    const real t2 = dt_0 * 0.5;
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
 * 14 add, 14 mul, 2 div, 1 call, 4 other */
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
    const real t9 = 1.0 / x_1;
    const real t10 = p_1 * t9;
    const real t11 = -t10;
    const real t12 = exp(t11);
    const real t13 = t6 * t12;
    const real t14 = t4 - t13;
    const real t15 = 1.0 - x_1;
    const real t16 = u_0 * t15;
    const real t17 = t13 + t13;
    const real t18 = t16 + t17;
    const real t21 = x_1 - 0.5;
    const real t22 = u_1 * t21;
    const real t23 = 1.0 + u_1;
    const real t24 = 1.0 / t23;
    const real t25 = t22 * t24;
    const real t26 = t18 - t25;
    const real t27 = p_0 * t12;
    const real t28 = u_0 + t27;
    const real t29 = -t28;
    const real t30 = t27 + t27;
    const real t31 = t9 * t10;
    const real t32 = t12 * t31;
    const real t33 = t6 * t32;
    const real t34 = -t33;
    const real t35 = t33 + t33;
    const real t36 = t35 - u_0;
    const real t37 = u_1 * t24;
    const real t38 = t36 - t37;
    const real t40 = t21 * t24;
    const real t41 = t24 * t25;
    const real t42 = t40 - t41;
    const real t43 = -t42;
    K[0] = t14;
    K[1] = t26;
    fx[0] = t29;
    fx[1] = t30;
    fx[2] = t34;
    fx[3] = t38;
    Fu[0] = 0.0;
    Fu[1] = 0.0;
    Fu[2] = t3;
    Fu[3] = 0.0;
    Fu[4] = 0.0;
    Fu[5] = 0.0;
    Fu[6] = t15;
    Fu[7] = t43;
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
 * 180 add, 211 mul, 8 div, 4 call, 16 other */
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
    ptrdiff_t step, c, i;
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
