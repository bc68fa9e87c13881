
define internal ptr @error(ptr %frame, ptr %message) {{
entry:
  %given = alloca {{ i64, ptr, ptr, i32 }}
  %told = insertvalue {{ i64, ptr, ptr, i32 }} {{ i64 28, ptr null, ptr null, i32 {internal} }},
    ptr %message, 2
  store {{ i64, ptr, ptr, i32 }} %told, ptr %given
  %interface_place = getelementptr i8, ptr %frame, i64 16
  %interface = load ptr, ptr %interface_place
  %create_place = getelementptr i8, ptr %interface, i64 48
  %create = load ptr, ptr %create_place
  %made = call ptr %create(ptr %given)
  ret ptr %made
}}
